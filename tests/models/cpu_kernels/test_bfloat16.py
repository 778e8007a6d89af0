"""bf16 in kernels against torch's conversions, bit for bit."""

import numba
import numpy as np
import torch

from pcdet_avp.models.cpu_kernels.bfloat16 import bits_of, single, stored


@numba.njit
def _copied(values, out):
    for i in range(len(values)):
        out[i] = stored(out, single(values[i]))


def all_kinds() -> torch.Tensor:
    """Random bit patterns, ties between two bf16 numbers, both infinities, NaN, zeros, the smallest and the largest."""
    generator = torch.Generator().manual_seed(3)
    bits = torch.randint(-(2**31), 2**31, (20_000,), generator=generator, dtype=torch.int64).to(torch.int32)
    ties = (bits[:2000] & ~0xFFFF) | 0x8000
    odd = torch.tensor([0.0, -0.0, torch.inf, -torch.inf, torch.nan, 1e-45, 3.4028235e38, -3.4028235e38])
    return torch.cat([bits.view(torch.float32), ties.view(torch.float32), odd])


def test_rounding_is_torch_s():
    values, out = all_kinds(), torch.empty(22_008, dtype=torch.bfloat16)
    _copied(bits_of(values), bits_of(out))
    expected = values.bfloat16()
    assert torch.equal(out.isnan(), values.isnan())
    numbers = ~values.isnan()
    assert torch.equal(out.view(torch.int16)[numbers], expected.view(torch.int16)[numbers])


def test_reading_is_torch_s():
    every = torch.arange(-(2**15), 2**15).to(torch.int16).view(torch.bfloat16)
    out = torch.empty(len(every))
    _copied(bits_of(every), bits_of(out))
    np.testing.assert_array_equal(out.numpy(), every.float().numpy())


def test_float32_passes_unchanged():
    values, out = all_kinds(), torch.empty(22_008)
    _copied(bits_of(values), bits_of(out))
    np.testing.assert_array_equal(out.numpy(), values.numpy())
