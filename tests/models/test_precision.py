"""Which precision is taken where, and that only convolutions are computed in it."""

import pytest
import torch

from pcdet_avp.errors import ConfigError
from pcdet_avp.models import precision
from pcdet_avp.models.backbones_2d.base_bev_backbone import BaseBEVBackbone
from pcdet_avp.models.precision import chosen_precision, computing_in, convolutions

CPU = torch.device("cpu")
BACKBONE = {
    "LAYER_NUMS": [1, 1],
    "LAYER_STRIDES": [1, 2],
    "NUM_FILTERS": [16, 24],
    "UPSAMPLE_STRIDES": [1, 2],
    "NUM_UPSAMPLE_FILTERS": [16, 16],
}


@pytest.fixture
def cpu(monkeypatch, tmp_path):
    """Pretend to be another CPU: torch's name of its instructions, and the system's flags."""

    def pretend(capability: str, flags: str | None):
        file = tmp_path / "cpuinfo"
        if flags is not None:
            file.write_text(f"processor\t: 0\nmodel name\t: Some CPU\nflags\t\t: fpu {flags} sse\n")
        monkeypatch.setattr(precision, "CPU_INFO", file)
        monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: capability)
        precision.has_bf16_instructions.cache_clear()

    yield pretend
    precision.has_bf16_instructions.cache_clear()


@pytest.mark.parametrize(
    ("capability", "flags", "expected"),
    [
        ("AVX512", "avx512f avx512_bf16", "bf16"),
        ("AVX512", "avx512f amx_bf16 amx_tile", "bf16"),
        ("AVX512", "avx512f avx512_vnni", "float32"),
        ("AVX2", "avx2 avx512_bf16", "float32"),  # torch was told to do without
        ("AVX512", None, "float32"),  # no such file on this system
    ],
)
def test_auto_takes_what_the_cpu_is_fast_in(cpu, capability, flags, expected):
    cpu(capability, flags)
    assert chosen_precision("auto", CPU) == expected
    assert chosen_precision("float32", CPU) == "float32"
    assert chosen_precision("bf16", CPU) == "bf16"


def test_a_gpu_computes_in_float32():
    assert chosen_precision("auto", torch.device("cuda")) == "float32"
    with pytest.raises(ConfigError, match=r"--precision bf16: for inference on a CPU, found the device cuda"):
        chosen_precision("bf16", torch.device("cuda"))


def test_unknown_names_are_refused():
    with pytest.raises(ConfigError, match=r"--precision: expected one of auto, float32, bf16, found 'fp16'"):
        chosen_precision("fp16", CPU)


def test_convolutions_alone_and_inference_alone():
    with computing_in("bf16"):
        with convolutions():
            assert not torch.is_autocast_enabled("cpu")  # gradients are recorded
        with torch.no_grad():
            assert not torch.is_autocast_enabled("cpu")
            with convolutions():
                assert torch.is_autocast_enabled("cpu")
    with torch.no_grad(), convolutions():
        assert not torch.is_autocast_enabled("cpu")


def test_the_backbone_rounds_as_bf16_does():
    """Every sum is of products of bf16 numbers: the error is of the order of 2^-8, and not zero."""
    torch.manual_seed(0)
    backbone, x = BaseBEVBackbone(BACKBONE, 16).eval(), torch.randn(1, 16, 24, 20)
    with torch.no_grad():
        exact = backbone.encode(x)
        with computing_in("bf16"):
            rough = backbone.encode(x)
    assert rough.dtype == torch.bfloat16
    error = (rough.float() - exact).abs().mean() / exact.abs().mean()
    assert 2**-12 < float(error) < 2**-6
