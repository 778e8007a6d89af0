"""Bytes between compressor and decompressor change nothing but what is known of the size."""

import pytest
import torch

from pcdet_avp.errors import ConfigError
from pcdet_avp.link import MapStamp
from pcdet_avp.models.compression.bev_codec import BevCodec, Latent, NoCompression
from pcdet_avp.models.compression.map_packets import MapPacker
from pcdet_avp.models.compression.wire import Wire


@pytest.fixture(params=["float16", "int8"])
def codec(request):
    torch.manual_seed(0)
    codec = BevCodec({"PRECISION": request.param, "THRESHOLD": "rate", "TARGET_SHARE": 0.2}, channels=32)
    return codec.eval()


def _latents(codec, present):
    """Of two samples; the second's sensors as in ``present`` (camera, LiDAR)."""
    maps = {f"infra_{name}": torch.randn(2, 32, 12, 10) for name in ("camera", "lidar")}
    source_present = torch.tensor([[1.0, 1, 1, 1], [1, 1, *present]])
    with torch.no_grad():
        return codec.compress({"bev_maps": maps, "source_present": source_present})["latents"]


@pytest.mark.parametrize("present", [(1, 1), (0, 1)])
def test_what_arrives_is_what_was_sent(codec, present):
    latents = _latents(codec, present)
    arrived = Wire(codec)(latents)
    assert arrived.keys() == latents.keys()
    for source, latent in latents.items():
        assert latent.values.count_nonzero() > 0
        assert torch.equal(arrived[source].values, latent.values)
        assert torch.equal(arrived[source].received, latent.received)


def test_bytes_are_counted_for_the_maps_that_were_sent_and_once(codec):
    wire = Wire(codec)
    wire(_latents(codec, (0, 1)))
    sizes = wire.take_sizes()
    assert {modality: len(bytes_) for modality, bytes_ in sizes.items()} == {"camera": 1, "lidar": 2}
    # 20 % of 6 x 5 cells, four channels of at most two bytes and a mask, and a header.
    assert all(6 < size < 6 * 4 * 2 + 64 for of_modality in sizes.values() for size in of_modality)
    assert wire.take_sizes() == {}


def test_an_empty_map_arrives_as_known_to_be_empty(codec):
    nothing = Latent(torch.zeros(1, 4, 6, 5), torch.ones(1, 1, 6, 5, dtype=torch.bool))
    arrived = Wire(codec)({"infra_camera": nothing})["infra_camera"]
    assert arrived.received.all()
    assert not arrived.values.any()


def test_uncompressed_maps_have_no_packet():
    with pytest.raises(ConfigError, match=r"--wire: .*no bytes"):
        Wire(NoCompression({}, 32))


LIMITED = {"PRECISION": "int8", "THRESHOLD": "rate", "TARGET_SHARE": 0.9, "MAX_BYTES": 120}


@pytest.mark.parametrize("constant", [False, True])
@pytest.mark.parametrize("precision", ["float16", "int8"])
def test_every_map_obeys_the_configured_limit(precision, constant):
    torch.manual_seed(0)
    codec = BevCodec({**LIMITED, "PRECISION": precision, "CONSTANT_SIZE": constant}, channels=32).eval()
    latents, wire = _latents(codec, (1, 1)), Wire(codec)
    arrived = wire(latents)
    sizes = [size for of_modality in wire.take_sizes().values() for size in of_modality]
    assert len(sizes) == 4
    assert all(size == 120 if constant else 100 < size <= 120 for size in sizes)
    for source, latent in latents.items():
        for sent, known in zip(latent.values, arrived[source].values, strict=True):
            kept = (known != 0).any(0)
            if precision == "float16":  # the longest cells, as they were
                assert 0 < kept.sum() < (sent != 0).any(0).sum()
                assert torch.equal(known, torch.where(kept, sent, 0))
                assert sent.norm(dim=0)[kept].min() >= sent.norm(dim=0)[~kept].max()
            else:  # nearly all cells, in steps of 1/4 at most
                assert kept.sum() >= 0.9 * (sent != 0).any(0).sum()
                assert (known - sent).abs().amax() <= 0.125
                assert not torch.equal(known, sent)
        assert arrived[source].received.all()


def test_a_budget_makes_the_limit_tighter_and_never_wider():
    codec = BevCodec({**LIMITED, "CONSTANT_SIZE": True}, channels=32)
    values = torch.randn(4, 6, 5)
    for budget, size in ((None, 120), (5000, 120), (100, 100)):
        payloads = MapPacker(codec, 400, "a test", budget).pack(values, MapStamp(0, 0, "lidar", 0.0, 0.0, 0.0))
        assert [len(payload) for payload in payloads] == [size]


def test_limits_that_no_map_can_keep_are_refused_before_there_is_one():
    tight = BevCodec({**LIMITED, "MAX_BYTES": 55, "CONSTANT_SIZE": True}, channels=32)
    with pytest.raises(ConfigError, match=r"MAX_BYTES: expected 56 or more, an empty int8 map of 4 x 3 x 2 of"):
        tight.check_size(6, 4)
    with pytest.raises(ConfigError, match=r"CONSTANT_SIZE: expected MAX_BYTES beside it"):
        BevCodec({"CONSTANT_SIZE": True}, channels=32)
    with pytest.raises(ConfigError, match=r"CONSTANT_SIZE: expected MAX_BYTES of 100 or less, .*found 120"):
        Wire(BevCodec({**LIMITED, "CONSTANT_SIZE": True}, channels=32), max_segment_bytes=100)
