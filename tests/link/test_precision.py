"""Rounding on the wire against numbers worked out by hand and against plain numpy."""

import numpy as np
import pytest

from pcdet_avp.errors import PacketError
from pcdet_avp.link import int8_exponents, rounded
from pcdet_avp.link.precision import from_codes, to_codes


def test_float16_is_numpys_rounding(make_map):
    latent = make_map(np.random.default_rng(0), (3, 5, 7), 0.5)
    np.testing.assert_array_equal(rounded(latent, "float16"), latent.astype(np.float16).astype(np.float32))


def test_every_finite_float16_survives_its_code():
    halves = np.arange(1 << 16, dtype=np.uint16).view(np.float16)
    halves = halves[np.isfinite(halves)].reshape(1, 1, -1)
    np.testing.assert_array_equal(rounded(halves, "float16"), halves.astype(np.float32))


def test_int8_by_hand():
    """127 fits step 1, 128 needs step 2; 0.3 and 5 in steps of 2 are 0 and 2 (2.5 rounds to the even 2) steps."""
    latent = np.array([[[127.0, -3.4]], [[128.0, 5.0]], [[0.0, 0.0]], [[0.25, -0.1]]], np.float32)
    np.testing.assert_array_equal(int8_exponents(latent), [0, 1, 0, -8])
    expected = [[[127.0, -3.0]], [[128.0, 4.0]], [[0.0, 0.0]], [[0.25, -26 / 256]]]
    np.testing.assert_array_equal(rounded(latent, "int8"), np.array(expected, np.float32))


def test_int8_is_off_by_half_a_step_at_most_and_rounding_twice_is_rounding_once(make_map):
    latent = make_map(np.random.default_rng(1), (6, 20, 20), 0.7)
    once = rounded(latent, "int8")
    step = 2.0 ** int8_exponents(latent)[:, None, None]
    assert (np.abs(once - latent) <= step / 2).all()
    np.testing.assert_array_equal(rounded(once, "int8"), once)


def test_coarser_steps_clip_nothing_and_finer_ones_clip():
    latent = np.array([[[100.0, -100.0]]], np.float32)
    np.testing.assert_array_equal(rounded(latent, "int8", np.array([3])), [[[96.0, -96.0]]])
    np.testing.assert_array_equal(rounded(latent, "int8", np.array([-1])), [[[63.5, -63.5]]])


def test_minus_zero_is_empty():
    codes = to_codes(np.array([[[-0.0, 0.0]]], np.float32), "float16", None)
    values = from_codes(codes, "float16", None)
    assert not np.signbit(values).any()


@pytest.mark.parametrize("precision", ["float16", "int8"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_a_number_is_refused(precision, bad):
    with pytest.raises(PacketError, match=precision):
        rounded(np.array([[[1.0, bad]]], np.float32), precision)


def test_beyond_float16_is_refused():
    with pytest.raises(PacketError, match="65504"):
        rounded(np.array([[[7e4]]], np.float32), "float16")
