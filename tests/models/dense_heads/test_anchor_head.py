"""The head: shapes and names, what a perfect output costs and decodes to, normalisation per class."""

import math

import pytest
import torch
from easydict import EasyDict

from pcdet_avp.errors import ConfigError, GeometryError
from pcdet_avp.models.dense_heads.anchor_head import AnchorHeadSingle, anchor_classes
from pcdet_avp.models.dense_heads.box_coder import direction_class, encode

CLASSES = ["Car", "Pedestrian"]
RANGE, SIZE = [0.0, -6.4, -0.5, 9.6, 6.4, 3.5], [24, 32, 1]  # 0.4 m cells: 32 rows x 24 columns


def config(**changes):
    car = dict(class_name="Car", anchor_sizes=[[4.2, 1.9, 1.6]], anchor_rotations=[0, 1.57])
    car |= dict(anchor_bottom_heights=[0.0], feature_map_stride=2, matched_threshold=0.6, unmatched_threshold=0.45)
    person = dict(class_name="Pedestrian", anchor_sizes=[[0.55, 0.55, 1.7]], anchor_rotations=[0])
    person |= dict(anchor_bottom_heights=[0.0], feature_map_stride=2, matched_threshold=0.25, unmatched_threshold=0.15)
    weights = dict(cls_weight=1.0, loc_weight=2.0, dir_weight=0.2, code_weights=[1.0] * 7)
    cfg = dict(ANCHOR_GENERATOR_CONFIG=[car, person | {"heading_weight": 0.1}], LOSS_CONFIG={"LOSS_WEIGHTS": weights})
    return EasyDict(cfg | changes)


def make(**changes):
    torch.manual_seed(0)
    return AnchorHeadSingle(config(**changes), 8, 2, CLASSES, SIZE, RANGE, voxel_size=[0.4, 0.4, 4])


GT = torch.tensor(
    [
        [[4.1, 1.0, 0.8, 4.5, 1.9, 1.6, 0.1, 1], [7.3, -3.1, 0.9, 0.375, 0.375, 1.8, -2.0, 2]],
        [[5.0, -2.0, 0.7, 4.0, 1.8, 1.5, math.pi - 0.2, 1], [0] * 8],
    ]
)


def perfect_outputs(head, gt_boxes):
    """The raw outputs that say exactly what the targets ask for."""
    labels, box_index = head.assign_targets(gt_boxes)
    boxes = torch.stack([gt[index, :7] for gt, index in zip(gt_boxes, box_index, strict=True)])
    cls_preds = torch.full((*labels.shape, 2), -12.0)
    cls_preds[labels > 0] = torch.nn.functional.one_hot(labels[labels > 0] - 1, 2) * 24.0 - 12
    codes = torch.where((labels > 0)[..., None], encode(boxes.clamp(min=1e-3), head.anchors), 0)
    codes[labels > 0] = encode(boxes[labels > 0], head.anchors.expand(len(labels), -1, -1)[labels > 0])
    directions = torch.nn.functional.one_hot(direction_class(boxes[..., 6], head.direction_offset, 2), 2) * 20.0
    return {"cls_preds": cls_preds, "box_preds": codes, "dir_cls_preds": directions, "gt_boxes": gt_boxes}


def test_shapes_and_weight_names_are_openpcdets():
    head = make()
    assert set(head.state_dict()) == {f"conv_{n}.{p}" for n in ("cls", "box", "dir_cls") for p in ("weight", "bias")}
    assert head.conv_cls.weight.shape == (3 * 2, 8, 1, 1)
    assert (head.conv_cls.bias == -4.6).all()
    out = head.eval()({"spatial_features_2d": torch.randn(2, 8, 16, 12)})
    assert out["batch_box_preds"].shape == (2, 16 * 12 * 3, 7)
    assert out["batch_cls_preds"].shape == (2, 16 * 12 * 3, 2)
    assert "batch_box_preds" not in head.train()({"spatial_features_2d": torch.randn(1, 8, 16, 12)})


def test_outputs_and_anchors_share_one_order():
    """A bump of one channel at one cell moves the one anchor that stands there."""
    head = make().eval()
    torch.nn.init.zeros_(head.conv_box.weight)
    torch.nn.init.zeros_(head.conv_box.bias)
    with torch.no_grad():
        head.conv_box.weight[2 * 7 + 2, 0] = 1.0  # z of the third anchor, the pedestrian's
    x = torch.zeros(1, 8, 16, 12)
    x[0, 0, 5, 7] = 1.0
    moved = (head.decode(head({"spatial_features_2d": x})["box_preds"], None)[0] - head.anchors).abs().sum(1)
    (row,) = moved.nonzero().squeeze(1).tolist()
    assert head.anchors[row, :2].tolist() == pytest.approx([7.5 * 0.8, -6.4 + 5.5 * 0.8])
    assert head.anchors[row, 3].item() == pytest.approx(0.55)


def test_perfect_outputs_cost_nothing_and_decode_to_the_truth():
    head = make()
    outputs = perfect_outputs(head, GT)
    loss, terms = head.get_loss(outputs)
    assert loss.item() == pytest.approx(0, abs=1e-5)
    assert set(terms) == {"rpn_loss", "rpn_loss_cls", "rpn_loss_loc", "rpn_loss_dir"}
    boxes = head.decode(outputs["box_preds"], outputs["dir_cls_preds"])
    labels, box_index = head.assign_targets(GT)
    for i in range(2):
        positive = labels[i] > 0
        truth = GT[i][box_index[i, positive], :7]
        difference = boxes[i, positive] - truth
        difference[:, 6] = torch.remainder(difference[:, 6] + math.pi, 2 * math.pi) - math.pi
        assert difference.abs().max() < 1e-4


def test_the_direction_classifier_tells_front_from_back():
    """The box code is the same for both headings (the sine does not care); the sector decides."""
    head = make()
    outputs = perfect_outputs(head, GT)
    flipped = head.decode(outputs["box_preds"], -outputs["dir_cls_preds"])
    right = head.decode(outputs["box_preds"], outputs["dir_cls_preds"])
    turn = torch.remainder(flipped[..., 6] - right[..., 6] + 1e-3, 2 * math.pi)
    torch.testing.assert_close(turn, torch.full_like(turn, math.pi + 1e-3), atol=1e-4, rtol=0)
    wrong = outputs | {"dir_cls_preds": -outputs["dir_cls_preds"]}
    assert head.get_loss(wrong)[1]["rpn_loss_dir"] > 1
    assert head.get_loss(wrong)[1]["rpn_loss_loc"] < 1e-5


def test_every_class_is_divided_by_its_own_positives():
    """Cars alone, pedestrians alone, both: the losses add, however many positives either class has."""
    head = make()
    out = {name: torch.randn(1, 16 * 12 * 3, n) for name, n in (("cls_preds", 2), ("box_preds", 7))}
    out["dir_cls_preds"] = torch.randn(1, 16 * 12 * 3, 2)
    both, cars, people = GT[:1], GT[:1].clone(), GT[:1].clone()
    cars[:, 1], people[:, 0] = 0, 0
    terms = [head.get_loss(out | {"gt_boxes": gt})[1] for gt in (both, cars, people)]
    for key in ("rpn_loss_loc", "rpn_loss_dir"):
        torch.testing.assert_close(terms[0][key], terms[1][key] + terms[2][key])


def test_an_error_of_the_heading_counts_by_the_weight_of_its_class():
    """Smooth L1 with beta 1 / 9 is 4.5 x^2 below it; x is the sine of the error times the weight: 1 for cars, 0.1."""
    head = make()
    out = perfect_outputs(head, GT)
    labels, _ = head.assign_targets(GT)
    for number, weight in ((1, 1.0), (2, 0.1)):
        codes = out["box_preds"].clone()
        codes[..., 6] += 0.05 * (labels == number)
        terms = head.get_loss(out | {"box_preds": codes})[1]
        assert float(terms["rpn_loss_loc"]) == pytest.approx(2.0 * 4.5 * (weight * math.sin(0.05)) ** 2, rel=1e-3)


def test_repeating_a_sample_changes_no_term():
    head = make()
    out = {"cls_preds": torch.randn(1, 576, 2), "box_preds": torch.randn(1, 576, 7)}
    out |= {"dir_cls_preds": torch.randn(1, 576, 2), "gt_boxes": GT[:1]}
    twice = {key: value.repeat(2, 1, 1) for key, value in out.items()}
    torch.testing.assert_close(head.get_loss(out)[0], head.get_loss(twice)[0])


def test_an_empty_scene_is_a_valid_negative():
    head = make()
    out = head({"spatial_features_2d": torch.randn(2, 8, 16, 12)}) | {"gt_boxes": torch.zeros(2, 0, 8)}
    loss, terms = head.get_loss(out)
    loss.backward()
    assert terms["rpn_loss_loc"] == 0
    assert head.conv_cls.weight.grad.abs().sum() > 0


def test_ground_truth_and_anchors_are_left_alone():
    head, gt = make(), GT.clone()
    anchors = head.anchors.clone()
    head.get_loss(perfect_outputs(head, gt))
    assert torch.equal(gt, GT)
    assert torch.equal(head.anchors, anchors)


def test_bad_input_is_named():
    with pytest.raises(ConfigError, match="Car"):
        AnchorHeadSingle(config(), 8, 1, ["Van"], SIZE, RANGE)
    with pytest.raises(GeometryError, match=r"\(16, 12\)"):
        make()({"spatial_features_2d": torch.zeros(1, 8, 16, 11)})
    bad = GT.clone()
    bad[0, 0, 4] = 0
    with pytest.raises(GeometryError, match="positive"):
        make().get_loss({"gt_boxes": bad})


def test_no_direction_classifier_means_none():
    head = make(USE_DIRECTION_CLASSIFIER=False)
    assert head.conv_dir_cls is None
    out = head({"spatial_features_2d": torch.randn(1, 8, 16, 12)}) | {"gt_boxes": GT[:1]}
    assert head.get_loss(out)[1]["rpn_loss_dir"] == 0


@pytest.mark.parametrize("directions", [True, False])
def test_the_layers_together_give_what_each_gives_alone(directions):
    head, x = make(USE_DIRECTION_CLASSIFIER=directions), torch.randn(2, 8, 16, 12)
    out = head.train()({"spatial_features_2d": x})
    for name, values in (("cls", 2), ("box", 7), ("dir_cls", 2)):
        layer = getattr(head, f"conv_{name}")
        if layer is None:
            assert out[f"{name}_preds"] is None
            continue
        alone = layer(x).permute(0, 2, 3, 1).reshape(2, -1, values)
        torch.testing.assert_close(out[f"{name}_preds"], alone)


def test_two_entries_of_one_class_are_refused_and_the_place_for_both_is_named():
    """Before, the first of the two was dropped without a word."""
    car, person = config()["ANCHOR_GENERATOR_CONFIG"]
    with pytest.raises(ConfigError, match=r"two entries for 'Car'; put all its sizes into one entry's anchor_sizes"):
        make(ANCHOR_GENERATOR_CONFIG=[car, person, {**car, "anchor_sizes": [[5.0, 2.0, 1.8]]}])


def test_anchors_of_a_class_that_is_not_asked_for_are_left_out_and_a_missing_one_is_named():
    both, cars = anchor_classes(config(), CLASSES), anchor_classes(config(), ["Car"])
    assert [c.name for c in cars] == ["Car"]
    assert cars[0] == both[0]
    head = AnchorHeadSingle(config(), 8, 1, ["Car"], SIZE, RANGE, voxel_size=[0.4, 0.4, 4])
    assert head.conv_cls.out_channels == 2  # one class, two headings
    only_cars = config()["ANCHOR_GENERATOR_CONFIG"][:1]
    with pytest.raises(ConfigError, match=r"anchors for \['Car'\], but the classes are \['Car', 'Pedestrian'\]"):
        anchor_classes(config(ANCHOR_GENERATOR_CONFIG=only_cars), CLASSES)
