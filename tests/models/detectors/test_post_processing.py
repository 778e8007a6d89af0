"""Thresholds and suppression per class; nothing upon the ego; recall counts."""

import pytest
import torch
from easydict import EasyDict

from pcdet_avp.errors import ConfigError, SensorError
from pcdet_avp.models.detectors.post_processing import PostProcessing

CLASSES = ["Car", "Pedestrian"]


def config(**changes):
    nms = {"NMS_THRESH": 0.1, "NMS_PRE_MAXSIZE": 100, "NMS_POST_MAXSIZE": 50}
    return EasyDict({"SCORE_THRESH": 0.3, "NMS_CONFIG": nms, "RECALL_THRESH_LIST": [0.3, 0.7]} | changes)


def box(x, y=0.0, dx=4.0, dy=2.0):
    return [x, y, 0.8, dx, dy, 1.6, 0.0]


def run(boxes, scores, gt=None, **changes):
    batch = {"batch_box_preds": torch.tensor([boxes]), "batch_cls_preds": torch.tensor([scores])}
    batch |= {"cls_preds_normalized": True} | ({} if gt is None else {"gt_boxes": torch.tensor([gt])})
    found, recall = PostProcessing(config(**changes), CLASSES)(batch)
    return found[0], recall


def test_a_person_beside_a_car_survives_and_a_double_does_not():
    boxes = [box(10), box(10.3), box(11, 0.9, 0.4, 0.4)]
    found, _ = run(boxes, [[0.9, 0.0], [0.8, 0.0], [0.0, 0.7]])
    assert found["pred_labels"].tolist() == [1, 2]
    assert found["pred_scores"].tolist() == pytest.approx([0.9, 0.7])
    assert found["pred_boxes"].tolist() == [pytest.approx(boxes[0]), pytest.approx(boxes[2])]


def test_boxes_that_are_suppressed_vote_within_their_class_alone():
    boxes, nms = [box(10), box(10.4), box(10.4)], dict(config()["NMS_CONFIG"])
    scores = [[0.9, 0.0], [0.9, 0.0], [0.0, 0.8]]
    for votes, x in ((0.3, 10.2), (0.0, 10.0), ({"Car": 0.3, "Pedestrian": 0.0}, 10.2)):
        found, _ = run(boxes, scores, NMS_CONFIG={**nms, "VOTE_IOU": votes})
        assert found["pred_boxes"][:, 0].tolist() == pytest.approx([x, 10.4])
        assert found["pred_scores"].tolist() == pytest.approx([0.9, 0.8])


def test_thresholds_may_differ_by_class():
    boxes, scores = [box(10), box(20)], [[0.4, 0.0], [0.0, 0.4]]
    found, _ = run(boxes, scores, SCORE_THRESH={"Car": 0.5, "Pedestrian": 0.3})
    assert found["pred_labels"].tolist() == [2]
    with pytest.raises(ConfigError, match="SCORE_THRESH"):
        run(boxes, scores, SCORE_THRESH={"Car": 0.5})


def test_a_detection_upon_the_ego_is_removed():
    """The ego reaches 2.4 m ahead: a 4 m box at 4.3 m overlaps it, one at 4.5 m does not."""
    found, _ = run([box(4.3), box(20.0)], [[0.9, 0], [0.5, 0]])
    assert found["pred_boxes"][:, 0].tolist() == [20.0]
    found, _ = run([box(4.5)], [[0.9, 0]])
    assert len(found["pred_boxes"]) == 1


def test_logits_become_scores():
    batch = {"batch_box_preds": torch.tensor([[box(10)]]), "batch_cls_preds": torch.tensor([[[0.0, -9.0]]])}
    found, _ = PostProcessing(config(), CLASSES)(batch | {"cls_preds_normalized": False})
    assert found[0]["pred_scores"].tolist() == [0.5]


def test_nothing_found_is_empty_but_whole():
    found, recall = run([box(10)], [[0.1, 0.1]], gt=[[*box(10), 1]])
    assert found["pred_boxes"].shape == (0, 7)
    assert found["pred_labels"].dtype == torch.int64
    assert recall == {"gt": 1, "rcnn_0.3": 0, "rcnn_0.7": 0}


def test_recall_by_hand():
    """An offset of 1 m leaves 3 of 5 m in common: IoU 0.6. Padding rows are no objects."""
    _, recall = run([box(11)], [[0.9, 0]], gt=[[*box(10), 1], [*box(30), 1], [0.0] * 8])
    assert recall == {"gt": 2, "rcnn_0.3": 1, "rcnn_0.7": 0}


def test_a_score_that_is_not_a_number_is_no_empty_road():
    with pytest.raises(SensorError, match="cls_preds: holds NaN"):
        run([box(10), box(20)], [[0.1, 0.1], [float("nan"), 0.1]])
