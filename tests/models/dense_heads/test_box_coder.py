"""Encode and decode undo each other; direction sectors restore the heading."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from pcdet_avp.models.dense_heads.box_coder import decode, direction_class, encode, turn_into_sector

position, size, heading = st.floats(-60, 60), st.floats(0.3, 6.0), st.floats(-math.pi, math.pi)
box = st.tuples(position, position, position, size, size, size, heading)


@settings(max_examples=100, deadline=None)
@given(box, box)
def test_decode_undoes_encode(target, anchor):
    target, anchor = (torch.tensor([values], dtype=torch.float64) for values in (target, anchor))
    before = (target.clone(), anchor.clone())
    torch.testing.assert_close(decode(encode(target, anchor), anchor), target, atol=1e-9, rtol=1e-9)
    assert torch.equal(target, before[0])
    assert torch.equal(anchor, before[1])


def test_codes_by_hand():
    anchor = torch.tensor([0.0, 0.0, 1.0, 4.0, 3.0, 2.0, 0.0])
    target = torch.tensor([5.0, -2.5, 2.0, 8.0, 3.0, 1.0, 0.5])
    expected = [1.0, -0.5, 0.5, math.log(2), 0.0, -math.log(2), 0.5]
    assert encode(target, anchor).tolist() == pytest.approx(expected)


def test_wild_outputs_decode_to_finite_boxes():
    anchor = torch.tensor([0.0, 0.0, 1.0, 4.0, 3.0, 2.0, 0.0])
    boxes = decode(torch.tensor([[1e3] * 7, [-1e3] * 7]), anchor)
    assert boxes.isfinite().all()
    assert (boxes[:, 3:6] > 0).all()


@settings(max_examples=100, deadline=None)
@given(heading, st.integers(-3, 3), st.sampled_from([1, 2, 4]))
def test_the_sector_restores_a_heading_known_up_to_its_period(angle, turns, bins):
    angle = torch.tensor(angle, dtype=torch.float64)
    sector = direction_class(angle, math.pi / 4, bins)
    restored = turn_into_sector(angle + turns * 2 * math.pi / bins, sector, math.pi / 4, bins)
    difference = float((restored - angle + math.pi) % (2 * math.pi) - math.pi)
    to_border = float((angle - math.pi / 4 + 1e-9) % (2 * math.pi / bins))
    if to_border > 1e-6:  # on the border of two sectors, rounding may choose either
        assert abs(difference) < 1e-9


def test_two_sectors_by_hand():
    """With an offset of 45 degrees, sector 0 is 45..225 degrees and sector 1 the rest."""
    degrees = torch.tensor([0.0, 30.0, 60.0, 180.0, -150.0, -120.0])
    assert direction_class(torch.deg2rad(degrees), math.pi / 4, 2).tolist() == [1, 1, 0, 0, 0, 1]
