"""Depth bins by their closed forms, the depth loss by hand, foreground by geometry."""

import math

import numpy as np
import pytest
import torch
from easydict import EasyDict
from torch.nn import functional as F

from pcdet_avp.errors import ConfigError
from pcdet_avp.models.backbones_image.depth_bins import MODES, DepthBins
from pcdet_avp.models.backbones_image.depth_head import DepthHead
from pcdet_avp.models.backbones_image.depth_loss import DepthLoss
from pcdet_avp.models.backbones_image.foreground import back_project, foreground_mask, inside_boxes
from pcdet_avp.structures.boxes import points_in_box
from pcdet_avp.structures.camera import PinholeCamera

CAMERA = PinholeCamera.looking_ahead(64, 48, math.pi / 2, 0.2, 1.8, math.radians(12))


def matrices(camera=CAMERA):
    to_cam = torch.tensor(camera.agent_from_camera.inverse().matrix, dtype=torch.float32)
    to_img = torch.tensor(np.c_[camera.intrinsics, np.zeros(3)], dtype=torch.float32)
    return to_cam[None], to_img[None]


@pytest.mark.parametrize("mode", MODES)
def test_edges_lie_at_whole_positions_and_centres_fall_into_their_bins(mode):
    bins = DepthBins(mode, 80, 2.0, 46.8)
    edges = bins.edges()
    assert edges[0] == 2.0
    assert math.isclose(edges[-1], 46.8)
    torch.testing.assert_close(bins.position(edges), torch.arange(81, dtype=torch.float64), atol=1e-9, rtol=0)
    assert bins.target((edges[1:] + edges[:-1]) / 2).tolist() == list(range(80))


def test_widths_of_the_bins():
    uniform, log, linear, inverse = (DepthBins(mode, 4, 1.0, 16.0).edges().diff() for mode in MODES)
    torch.testing.assert_close(uniform, torch.full((4,), 3.75, dtype=torch.float64))
    torch.testing.assert_close(log, torch.tensor([1.0, 2.0, 4.0, 8.0], dtype=torch.float64))
    torch.testing.assert_close(linear, torch.tensor([1.5, 3.0, 4.5, 6.0], dtype=torch.float64))
    edges = torch.tensor([64 / 64, 64 / 49, 64 / 34, 64 / 19, 64 / 4], dtype=torch.float64)  # 1 / d falls by 15 / 64
    torch.testing.assert_close(inverse, edges.diff())


def test_bins_even_in_inverse_depth_are_even_in_image_rows():
    """For the floor, and for a camera that looks down as well: each of the bins covers as many rows."""
    floor = np.c_[np.linspace(3, 30, 400), np.zeros((400, 2))]
    uv, depth = CAMERA.project(floor)
    position = DepthBins("INV", 50, 2.0, 40.0).position(torch.tensor(depth)).numpy()
    slope, offset = np.polyfit(uv[:, 1], position, 1)
    np.testing.assert_allclose(position, slope * uv[:, 1] + offset, atol=1e-6)


@pytest.mark.parametrize("mode", MODES)
def test_depths_outside_are_a_class_of_their_own(mode):
    bins = DepthBins(mode, 10, 2.0, 40.0)
    assert bins.target(torch.tensor([0.0, -3.0, 1.9, 40.1, 500.0])).tolist() == [10] * 5


def test_bad_bins_are_refused():
    with pytest.raises(ConfigError, match="UD, SID, LID, INV"):
        DepthBins("LOG", 10, 2.0, 40.0)
    with pytest.raises(ConfigError, match="nearest < farthest"):
        DepthBins("UD", 10, 4.0, 2.0)
    cfg = EasyDict(MODE="UD", NUM_BINS=8, RANGE_M={"ego": [1, 9], "infra": [4, 20]})
    assert DepthBins.from_config(cfg, "infra") == DepthBins("UD", 8, 4.0, 20.0)


def test_loss_by_hand():
    """Two known pixels, one of them foreground: -alpha (1 - p)^2 log p, weighted 13 and 1, over two pixels, times 3."""
    bins = DepthBins("UD", 3, 1.0, 4.0)
    logits = torch.log(torch.tensor([[0.5, 0.25, 0.125, 0.125], [0.1, 0.2, 0.3, 0.4], [0.7, 0.1, 0.1, 0.1]]))
    logits = logits.T.reshape(1, 4, 1, 3)
    depth = torch.tensor([[[1.5, 9.0, 0.0]]])  # bin 0, outside, unknown
    foreground = torch.tensor([[[True, False, True]]])
    expected = 0.25 * (13 * 0.5**2 * math.log(2) + 0.6**2 * math.log(2.5)) / 2 * 3
    loss = DepthLoss({})(logits, depth, foreground, bins)
    assert math.isclose(loss.item(), expected, rel_tol=1e-5)
    assert DepthLoss({})(logits, depth * 0, foreground, bins) == 0


def test_loss_without_focus_and_weights_is_cross_entropy():
    bins = DepthBins("LID", 7, 1.0, 20.0)
    generator = torch.Generator().manual_seed(0)
    logits, depth = torch.randn(2, 8, 5, 6, generator=generator), torch.rand(2, 5, 6, generator=generator) * 25 + 0.1
    loss = DepthLoss(EasyDict(WEIGHT=1, ALPHA=1, GAMMA=0, FG_WEIGHT=1))(logits, depth, depth > 5, bins)
    torch.testing.assert_close(loss / 2, F.cross_entropy(logits, bins.target(depth)))


def test_head_has_one_class_more_than_bins():
    assert DepthHead(8, 5, 16, "group")(torch.randn(2, 8, 4, 6)).shape == (2, 6, 4, 6)


def test_back_projection_inverts_the_projection():
    rng = np.random.default_rng(0)
    depth = torch.tensor(rng.uniform(2, 30, (1, 12, 16)), dtype=torch.float32)
    points = back_project(depth, *matrices(), stride=4)
    uv, z = CAMERA.project(points[0].numpy())
    np.testing.assert_allclose(z, depth[0], atol=1e-3)
    np.testing.assert_allclose(uv[..., 0], np.broadcast_to(np.arange(16) * 4 + 2, (12, 16)), atol=1e-2)
    np.testing.assert_allclose(uv[..., 1], np.broadcast_to(np.arange(12)[:, None] * 4 + 2, (12, 16)), atol=1e-2)


def test_points_inside_boxes_agree_with_the_box_module():
    rng = np.random.default_rng(1)
    points = rng.uniform([0, -5, 0], [12, 5, 2.5], (200, 3))
    boxes = np.array([[4, 1, 0.8, 4, 2, 1.6, 0.5], [9, -2, 0.9, 0.5, 0.5, 1.8, 0.0], [0, 0, 0, 0, 0, 0, 0]])
    inside = inside_boxes(torch.tensor(points)[None], torch.tensor(boxes)[None], margin=0.0)[0].numpy()
    expected = points_in_box(points, boxes[0]) | points_in_box(points, boxes[1])
    standing = points[:, 2] > 0.1  # the floor under a box is not foreground
    assert (inside == expected & standing).all()
    assert inside.sum() > 10


@pytest.mark.parametrize("shift", [0.0, 3.0])
def test_foreground_is_where_the_depth_meets_a_box(shift):
    """A wall of depth 10 m with a box standing in it; the mast's frame lies ``shift`` metres from the ego's."""
    depth = torch.full((1, 12, 16), 10.0)
    to_cam, to_img = matrices(PinholeCamera.looking_ahead(64, 48, math.pi / 2, 0.0, 1.8))
    box = torch.tensor([[[10.0 + shift, 2.0, 1.8, 1.0, 1.6, 1.6, 0.0, 1.0]]])
    pose = None
    if shift:
        pose = torch.eye(4)[None]
        pose[0, 0, 3] = shift
    mask = foreground_mask(depth, to_cam, to_img, 4, box, pose)[0]
    # 32 px focal length: y in [1, 3] (margin 0.2) is u in 32 - [3.2, 9.6], z in [1.1, 2.8] is v in 24 + [-3.2, 2.24].
    assert mask.nonzero().unique(dim=0).tolist() == [[r, c] for r in (5, 6) for c in (6,)]
    unknown = depth.clone()
    unknown[0, 5] = 0
    assert not foreground_mask(unknown, to_cam, to_img, 4, box, pose)[0, 5].any()
