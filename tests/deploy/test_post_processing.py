"""Boxes from raw outputs without torch: those that the network's own head and post-processing give."""

import numpy as np
import pytest
import torch
from easydict import EasyDict

from pcdet_avp.deploy import post_processing
from pcdet_avp.deploy.network import AnchorSet, Head, Suppression
from pcdet_avp.errors import SensorError
from pcdet_avp.models.dense_heads.anchor_head import AnchorHeadSingle
from pcdet_avp.models.detectors.post_processing import PostProcessing
from pcdet_avp.structures.bev_grid import BevGrid

GRID = BevGrid(0.0, -4.8, 0.0, 9.6, 4.8, 4.0, cell_m=0.4)
WEIGHTS = {"cls_weight": 1.0, "loc_weight": 1.0, "dir_weight": 1.0, "code_weights": [1.0] * 7}


def anchor(name, sizes, rotations, centred):
    return {
        "class_name": name,
        "anchor_sizes": sizes,
        "anchor_rotations": rotations,
        "anchor_bottom_heights": [0.1],
        "matched_threshold": 0.6,
        "unmatched_threshold": 0.4,
        "feature_map_stride": 2,
        "align_center": centred,
    }


@pytest.mark.parametrize(("bins", "centred"), [(2, True), (3, False), (0, True)])
def test_the_same_boxes_as_in_torch(bins, centred):
    cfg = EasyDict(
        USE_DIRECTION_CLASSIFIER=bins > 0,
        NUM_DIR_BINS=bins,
        DIR_OFFSET=0.7,
        ANCHOR_GENERATOR_CONFIG=[
            anchor("Car", [[4.6, 1.9, 1.7], [2.0, 1.0, 1.5]], [0, 1.57], centred),
            anchor("Pedestrian", [[0.5, 0.6, 1.7]], [0], centred),
        ],
        LOSS_CONFIG={"LOSS_WEIGHTS": WEIGHTS},
    )
    names = ["Car", "Pedestrian"]
    torch.manual_seed(bins)
    head = AnchorHeadSingle(cfg, 8, 2, names, [GRID.width, GRID.height, 1], GRID.range).eval().requires_grad_(False)
    features = 3 * torch.randn(1, 8, GRID.height // 2, GRID.width // 2)
    head.conv_cls.bias += 3
    for layer in filter(None, (head.conv_box, head.conv_dir_cls)):
        layer.weight.normal_(std=0.1)
    batch = head({"spatial_features_2d": features})
    limits = {"SCORE_THRESH": {"Car": 0.2, "Pedestrian": 0.4}, "NMS_CONFIG": {"NMS_THRESH": 0.2}}
    limits["NMS_CONFIG"] |= {
        "NMS_PRE_MAXSIZE": 150,
        "NMS_POST_MAXSIZE": 40,
        "VOTE_IOU": {"Car": 0.3, "Pedestrian": 0.0},
    }
    expected = PostProcessing(limits, names)(batch)[0][0]
    raw = {key: batch[key].numpy() for key in ("cls_preds", "box_preds", "dir_cls_preds") if batch[key] is not None}
    anchors = tuple(AnchorSet(tuple(map(tuple, one.boxes().tolist())), one.align_center) for one in head.classes)
    suppression = Suppression((0.2, 0.4), (0.2, 0.2), 150, 40, (0.3, 0.0))
    found = post_processing.detect(raw, GRID, Head(anchors, 2, bins, 0.7), suppression)
    assert len(expected["pred_boxes"]) > 20
    np.testing.assert_array_equal(found["pred_labels"], expected["pred_labels"])
    np.testing.assert_allclose(found["pred_scores"], expected["pred_scores"], atol=1e-6)
    np.testing.assert_allclose(found["pred_boxes"], expected["pred_boxes"], atol=1e-4)


def test_nothing_above_the_threshold_is_no_box():
    anchors = (AnchorSet(((0.8, 4.0, 2.0, 1.6, 0.0),), True),)
    raw = {"cls_preds": np.full((1, 144, 1), -9, np.float32), "box_preds": np.zeros((1, 144, 7), np.float32)}
    found = post_processing.detect(raw, GRID, Head(anchors, 2, 0, 0.0), Suppression((0.1,), (0.1,), 10, 10))
    assert found["pred_boxes"].shape == (0, 7)
    assert found["pred_scores"].shape == found["pred_labels"].shape == (0,)


def test_a_logit_that_is_not_a_number_is_no_empty_road():
    anchors = (AnchorSet(((0.8, 4.0, 2.0, 1.6, 0.0),), True),)
    raw = {"cls_preds": np.full((1, 144, 1), -9, np.float32), "box_preds": np.zeros((1, 144, 7), np.float32)}
    raw["cls_preds"][0, 70] = np.nan
    with pytest.raises(SensorError, match="cls_preds: holds NaN"):
        post_processing.detect(raw, GRID, Head(anchors, 2, 0, 0.0), Suppression((0.1,), (0.1,), 10, 10))
