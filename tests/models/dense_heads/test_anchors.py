"""Where anchors stand."""

import pytest
import torch

from pcdet_avp.errors import ConfigError, GeometryError
from pcdet_avp.models.dense_heads.anchors import AnchorClass, lay_out
from pcdet_avp.structures.bev_grid import BevGrid

GRID = BevGrid(0.0, -30.08, -0.5, 44.8, 30.08, 3.5, cell_m=0.16)  # the paper's
CAR = AnchorClass("Car", ((4.5, 1.9, 1.6),), (0.0, 1.57), 0.0, 0.6, 0.45)


def test_anchors_stand_at_the_centres_of_the_heads_cells():
    x, y = CAR.centres(GRID, stride=2)
    assert (len(x), len(y)) == (140, 188)
    assert x[0].item() == pytest.approx(0.16)
    assert x[-1].item() == pytest.approx(44.8 - 0.16)
    assert y[0].item() == pytest.approx(-30.08 + 0.16)
    assert (x.diff() - 0.32).abs().max() < 1e-5


def test_openpcdets_default_pitch_is_there_for_its_weights():
    spec = AnchorClass("Car", ((4.5, 1.9, 1.6),), (0.0,), 0.0, 0.6, 0.45, align_center=False)
    x, y = spec.centres(GRID, stride=2)
    assert x[0].item() == 0
    assert x[-1].item() == pytest.approx(44.8)
    assert x[1].item() == pytest.approx(44.8 / 139)
    assert y[1].item() == pytest.approx(-30.08 + 60.16 / 187)


def test_boxes_stand_on_the_floor_and_headings_vary_fastest():
    spec = AnchorClass("Car", ((4.0, 2.0, 1.5), (5.0, 2.0, 2.0)), (0.0, 1.5), 0.1, 0.6, 0.45)
    boxes = spec.boxes()
    assert boxes.shape == (4, 5)
    assert boxes[:, 4].tolist() == [0.0, 1.5, 0.0, 1.5]
    assert boxes[:, 1].tolist() == [4.0, 4.0, 5.0, 5.0]
    torch.testing.assert_close(boxes[:, 0], torch.tensor([0.85, 0.85, 1.1, 1.1]))


def test_layout_is_row_column_box():
    anchors = lay_out(torch.tensor([1.0, 2.0]), torch.tensor([5.0, 6.0, 7.0]), CAR.boxes())
    assert anchors.shape == (3, 2, 2, 7)
    assert anchors[2, 1, 0, :3].tolist() == pytest.approx([2.0, 7.0, 0.8])
    assert anchors[0, 0, 1, 6].item() == pytest.approx(1.57)


def test_bad_anchors_are_named():
    with pytest.raises(GeometryError, match="Van"):
        AnchorClass("Van", ((0.0, 1.0, 1.0),), (0.0,), 0.0, 0.6, 0.45)
    with pytest.raises(ConfigError, match="unmatched"):
        AnchorClass("Van", ((1.0, 1.0, 1.0),), (0.0,), 0.0, 0.4, 0.45)
    with pytest.raises(GeometryError, match="does not divide by 3"):
        CAR.centres(GRID, stride=3)
