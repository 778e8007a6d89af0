"""Bytes per slot against 3GPP's rule for the size of a transport block (TS 38.214, section 5.1.3.2, which section
8.1.3.2 takes over for the sidelink), written out here in exact fractions, and against sionna where it is installed."""

from fractions import Fraction
from math import ceil, floor

import pytest

from pcdet_avp.link.nr_v2x import BYTES_PER_SLOT, RESOURCE_ELEMENTS, SLOT_RESOURCE_ELEMENTS

# Table 5.1.3.1-1: bits per symbol and code rate times 1024.
SCHEMES = {7: (2, 526), 14: (4, 553), 21: (6, 616), 28: (6, 948)}


def block_bits(elements, symbol_bits, rate):
    """Steps 2 and 4 for more than 3824 bits and a code rate above a quarter, one layer."""
    bits = Fraction(elements * symbol_bits * rate, 1024)
    assert bits > 3824
    assert rate > 256
    n = next(n for n in range(30) if 2 ** (n + 6) > bits - 24)  # floor(log2(bits - 24)) - 5
    quantised = max(3840, 2**n * floor((bits - 24) / 2**n + Fraction(1, 2)))  # ties towards the next larger number
    blocks = ceil(Fraction(quantised + 24, 8424)) if quantised > 8424 else 1
    return 8 * blocks * ceil(Fraction(quantised + 24, 8 * blocks)) - 24


def test_the_rule_by_hand():
    """MCS 14, 5600 elements: 12096.875 bits, n = 8, round(47.16) = 47, so 12032 in two code blocks: 8 x 2 x 754 - 24.

    MCS 7, 5500 elements: 5650.4 bits, n = 7, round(43.96) = 44, so 5632 in one: 8 x 707 - 24.
    """
    assert block_bits(5600, 4, 553) == 8 * 2 * 754 - 24 == 8 * 1505
    assert block_bits(5500, 2, 526) == 8 * 707 - 24 == 8 * 704


@pytest.mark.parametrize("mcs", BYTES_PER_SLOT)
def test_bytes_per_slot_are_blocks_of_the_standard(mcs):
    """For every number of resource elements that the module names, and for the next one on either side no longer."""
    least, most = RESOURCE_ELEMENTS[mcs]
    assert {block_bits(elements, *SCHEMES[mcs]) for elements in range(least, most + 1)} == {8 * BYTES_PER_SLOT[mcs]}
    assert block_bits(least - 1, *SCHEMES[mcs]) < 8 * BYTES_PER_SLOT[mcs] < block_bits(most + 1, *SCHEMES[mcs])


def test_overheads_lie_between_13_and_18_percent_and_no_one_number_serves_all():
    assert SLOT_RESOURCE_ELEMENTS == 50 * 12 * 11
    shares = [1 - elements / SLOT_RESOURCE_ELEMENTS for pair in RESOURCE_ELEMENTS.values() for elements in pair]
    assert 0.128 < min(shares) < max(shares) < 0.176
    assert max(least for least, _ in RESOURCE_ELEMENTS.values()) > min(most for _, most in RESOURCE_ELEMENTS.values())


def test_without_any_overhead_a_slot_carries_more():
    assert {mcs: block_bits(SLOT_RESOURCE_ELEMENTS, *SCHEMES[mcs]) / 8 for mcs in SCHEMES} == {
        7: 848,
        14: 1793,
        21: 2946,
        28: 4612,
    }


def test_a_tie_goes_to_the_next_larger_number():
    """5184 / 128 is 40.5: 41, not Python's round(40.5) = 40. Of 16QAM, rate 434/1024, 3072 elements: 5208 bits."""
    assert block_bits(32 * 96, 4, 434) == 5248


@pytest.mark.slow
@pytest.mark.parametrize("mcs", BYTES_PER_SLOT)
def test_sionna_says_the_same(mcs):
    torch = pytest.importorskip("torch")
    nr = pytest.importorskip("sionna.phy.nr.utils", reason="sionna is not installed")
    symbol_bits, rate = SCHEMES[mcs]
    elements = torch.arange(5200, SLOT_RESOURCE_ELEMENTS + 1)
    sizes = nr.calculate_tb_size(
        modulation_order=torch.full_like(elements, symbol_bits),
        target_coderate=torch.full(elements.shape, rate / 1024, dtype=torch.float64),
        num_coded_bits=symbol_bits * elements,
        return_cw_length=False,
    )[0]
    assert sizes.tolist() == [block_bits(int(n), symbol_bits, rate) for n in elements]
    least, most = RESOURCE_ELEMENTS[mcs]
    assert set(sizes[least - 5200 : most + 1 - 5200].tolist()) == {8 * BYTES_PER_SLOT[mcs]}
