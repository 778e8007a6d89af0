"""A byte budget holds for every map, and what is given up is what was shortest."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcdet_avp.errors import PacketError
from pcdet_avp.link import MapStamp, decode, encode, encode_within, int8_exponents, rounded
from pcdet_avp.link.rate_control import coarsened, ranks_by_length

STAMP = MapStamp(frame_id=1, time_us=50_000, modality="camera", x_m=0.0, y_m=0.0, yaw_rad=0.0)
SHAPE = (4, 40, 30)
SEGMENT = 700


def size_of(payloads):
    return sum(map(len, payloads))


def squares(differences):
    return float(np.square(differences, dtype=np.float64).sum())


@given(budget=st.integers(200, 9000), share=st.floats(0, 1), precision=st.sampled_from(["float16", "int8"]))
def test_the_budget_holds_and_is_used(budget, share, precision):
    rng = np.random.default_rng(0)
    latent = rng.normal(size=SHAPE) * rng.exponential(size=SHAPE[1:]) * (rng.random(SHAPE[1:]) < share)
    payloads = encode_within(latent, STAMP, SEGMENT, precision, budget)
    assert size_of(payloads) <= budget
    whole = encode(latent, STAMP, SEGMENT, precision)
    if size_of(whole) <= budget:
        assert payloads == whole
    elif precision == "float16":
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


def test_the_finest_step_is_doubled_first_and_none_more_than_five_times():
    exponents = np.array([-5, -4, -5])
    found = [coarsened(exponents, doublings).tolist() for doublings in (0, 1, 2, 3, 4, 14, 15, 99)]
    assert found == [
        [-5, -4, -5],
        [-4, -4, -5],
        [-4, -4, -4],
        [-3, -4, -4],
        [-3, -3, -4],
        [0, 0, 0],
        [0, 1, 0],
        [0, 1, 0],
    ]
    assert coarsened(np.array([0, -20]), 6).tolist() == [1, -15]  # a channel of small values keeps some of them
    assert exponents.tolist() == [-5, -4, -5]


@pytest.mark.parametrize("budget", [700, 1475, 3000])
@pytest.mark.parametrize("share", [0.3, 1.0])
@pytest.mark.parametrize("spread", [0.0, 1.0])
def test_int8_takes_the_coarsest_steps_that_it_must(budget, share, spread):
    rng = np.random.default_rng(3)
    latent = rng.normal(size=SHAPE) * np.exp(spread * rng.normal(size=SHAPE[1:])) * (rng.random(SHAPE[1:]) < share)
    finest = int8_exponents(latent)

    def fits(doublings):
        return size_of(encode(latent, STAMP, 60_000, "int8", coarsened(finest, doublings))) <= budget

    least = next((doublings for doublings in range(21) if fits(doublings)), 21)
    if least == 0:
        pytest.skip("fits as it is")
    payloads = encode_within(latent, STAMP, 60_000, "int8", budget)
    arrived = decode(payloads)
    sent = np.array(arrived.format.exponents)
    assert size_of(payloads) <= budget
    assert any((sent == coarsened(finest, doublings)).all() for doublings in (least - 1, least))
    kept = arrived.values.any(0)
    steps = np.ldexp(1.0, sent)[:, None]
    assert (np.abs(arrived.values - latent)[:, kept] <= steps / 2 + 1e-12).all()
    if least <= 20:
        whole = rounded(latent, "int8", coarsened(finest, least))
        assert squares(arrived.values - latent) <= squares(whole - latent)


def test_of_an_even_map_coarser_steps_keep_more_than_fewer_cells_do():
    rng = np.random.default_rng(4)
    latent = rng.normal(size=SHAPE) * (rng.random(SHAPE[1:]) < 0.5)  # 600 cells of 4 values
    arrived = decode(encode_within(latent, STAMP, 60_000, "int8", 1475)).values
    rank = ranks_by_length(latent)
    at_full_steps = max(
        (np.where(rank < count, rounded(latent, "int8"), 0) for count in range(0, 600, 5)),
        key=lambda kept: np.count_nonzero(kept) * (size_of(encode(kept, STAMP, 60_000, "int8")) <= 1475),
    )
    assert np.count_nonzero(arrived.any(0)) > 1.5 * np.count_nonzero(at_full_steps.any(0))
    assert squares(arrived - latent) < squares(at_full_steps - latent) / 4


def test_a_map_without_values_beyond_one_is_sent_in_int8_within_any_budget():
    latent = np.zeros(SHAPE, np.float32)
    latent[0, 7, 7] = 1e-30
    for budget in (60, 100):
        assert size_of(encode_within(latent, STAMP, SEGMENT, "int8", budget)) <= budget
