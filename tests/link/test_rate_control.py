"""A byte budget holds for every map, and what is given up is what was shortest."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcdet_avp.errors import PacketError
from pcdet_avp.link import MapStamp, decode, encode, encode_within, rounded

STAMP = MapStamp(frame_id=1, time_us=50_000, modality="camera", x_m=0.0, y_m=0.0, yaw_rad=0.0)
SHAPE = (4, 40, 30)
SEGMENT = 700


def size_of(payloads):
    return sum(map(len, payloads))


@given(budget=st.integers(200, 9000), share=st.floats(0, 1), precision=st.sampled_from(["float16", "int8"]))
def test_the_budget_holds_and_is_used(budget, share, precision):
    rng = np.random.default_rng(0)
    latent = rng.normal(size=SHAPE) * rng.exponential(size=SHAPE[1:]) * (rng.random(SHAPE[1:]) < share)
    payloads = encode_within(latent, STAMP, SEGMENT, precision, budget)
    assert size_of(payloads) <= budget
    whole = encode(latent, STAMP, SEGMENT, precision)
    if size_of(whole) <= budget:
        assert payloads == whole
    else:
        cell = 2 * SHAPE[0] + 12  # a cell more may also cost a little mask
        assert size_of(payloads) >= 0.95 * budget - cell - 60  # or begin a segment, with its header


def test_the_longest_cells_survive_and_are_sent_as_they_were(make_map):
    rng = np.random.default_rng(1)
    latent = make_map(rng, SHAPE, 0.6)
    arrived = decode(encode_within(latent, STAMP, SEGMENT, "float16", 1500))
    kept = arrived.values.any(0)
    length = np.linalg.norm(latent.astype(np.float64), axis=0)
    assert 0 < kept.sum() < (length > 0).sum()
    assert length[kept].min() >= length[~kept].max()
    np.testing.assert_array_equal(arrived.values[:, kept], rounded(latent, "float16")[:, kept])
    assert arrived.present.all()


def test_cells_of_equal_length_do_not_break_the_budget():
    payloads = encode_within(np.ones((8, 60, 60)), STAMP, SEGMENT, "float16", 400)
    assert size_of(payloads) <= 400


def test_a_budget_below_an_empty_map_is_refused():
    with pytest.raises(PacketError, match=r"an empty map takes .* the budget is 20 B"):
        encode_within(np.ones(SHAPE), STAMP, SEGMENT, "float16", 20)
