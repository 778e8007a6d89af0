"""The SSD head of PointPillars: scores, boxes and directions for every anchor of the BEV map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from pcdet_avp.errors import ConfigError, GeometryError
from pcdet_avp.models.dense_heads import decode_kernel
from pcdet_avp.models.dense_heads.anchors import AnchorClass, lay_out
from pcdet_avp.models.dense_heads.box_coder import decode, direction_class, encode, turn_into_sector
from pcdet_avp.models.dense_heads.losses import box_loss, shared_normaliser, sigmoid_focal_loss
from pcdet_avp.models.dense_heads.target_assignment import Assignment, assign, check_targets
from pcdet_avp.models.pointwise import convolve_to_cells_last
from pcdet_avp.models.precision import convolutions, full_precision
from pcdet_avp.registry import DENSE_HEADS
from pcdet_avp.structures.bev_grid import BevGrid

# A score of 1 % at the start, so that the many background anchors do not drown the first steps.
INITIAL_SCORE_LOGIT = -4.6


@DENSE_HEADS.register("AnchorHeadSingle")
class AnchorHeadSingle(nn.Module):
    """OpenPCDet's head of this name: same keys, weight names and outputs.

    Anchors are laid out (y, x, class, size, heading). Every anchor scores all classes and is trained towards its own.
    Each class's share of every loss is divided by that class's positive anchors, so that the few small pedestrians
    weigh as much as the cars.
    """

    def __init__(
        self,
        model_cfg: Any,
        input_channels: int,
        num_class: int,
        class_names: Sequence[str],
        grid_size: Any,
        point_cloud_range: Any,
        predict_boxes_when_training: bool = False,
        voxel_size: Any = None,
    ) -> None:
        """``grid_size`` is OpenPCDet's (columns, rows, layers); ``voxel_size`` follows from it and is not used."""
        super().__init__()
        self.num_class = num_class
        self.predict_when_training = predict_boxes_when_training
        self.classes = anchor_classes(model_cfg, class_names)
        self._set_direction(model_cfg)
        self._set_loss(model_cfg["LOSS_CONFIG"]["LOSS_WEIGHTS"])
        stride = feature_map_stride(model_cfg)
        self._lay_out_anchors(grid_of(point_cloud_range, grid_size), stride)
        K = sum(self.anchors_per_cell)
        self.conv_cls = nn.Conv2d(input_channels, K * num_class, 1)
        self.conv_box = nn.Conv2d(input_channels, K * 7, 1)
        self.conv_dir_cls = nn.Conv2d(input_channels, K * self.bins, 1) if self.bins else None
        nn.init.constant_(self.conv_cls.bias, INITIAL_SCORE_LOGIT)
        nn.init.normal_(self.conv_box.weight, std=0.001)

    def _set_direction(self, cfg: Any) -> None:
        self.bins = int(cfg.get("NUM_DIR_BINS", 2)) if cfg.get("USE_DIRECTION_CLASSIFIER", True) else 0
        self.direction_offset = float(cfg.get("DIR_OFFSET", math.pi / 4))

    def _set_loss(self, weights: Any) -> None:
        self.cls_weight, self.loc_weight = float(weights["cls_weight"]), float(weights["loc_weight"])
        self.dir_weight = float(weights["dir_weight"])
        self.register_buffer("code_weights", torch.tensor(list(weights["code_weights"])).float(), persistent=False)
        heading = torch.tensor([c.heading_weight for c in self.classes])
        self.register_buffer("heading_weights", heading, persistent=False)

    def _lay_out_anchors(self, grid: BevGrid, stride: int) -> None:
        anchors, of_class = [], []
        for k, spec in enumerate(self.classes):
            x, y, boxes = *spec.centres(grid, stride), spec.boxes()
            for name, value in (("x", x), ("y", y), ("boxes", boxes)):
                self.register_buffer(f"anchor_{name}_{k}", value, persistent=False)
            anchors.append(lay_out(x, y, boxes))
            of_class += [k] * len(boxes)
        self.anchors_per_cell = [of_class.count(k) for k in range(len(self.classes))]
        anchors = torch.cat(anchors, 2)  # (H, W, K, 7)
        self.register_buffer("anchors", anchors.flatten(0, 2), persistent=False)
        self.register_buffer("anchor_class", torch.tensor(of_class), persistent=False)  # (K,)
        self.map_shape = tuple(anchors.shape[:2])

    def forward(self, batch_dict: dict) -> dict:
        """
        Args: batch_dict:
            spatial_features_2d (B, C, H, W)
            min_scores (num_class,), optional: of one sample, at inference on a CPU, only anchors are wanted that may
            score above them; the last three results then hold no others, and the first three do not exist
        Returns: batch_dict with
            cls_preds (B, A, num_class), box_preds (B, A, 7), dir_cls_preds (B, A, NUM_DIR_BINS): raw outputs, and in
            evaluation batch_cls_preds (B, A, num_class) logits, batch_box_preds (B, A, 7), cls_preds_normalized False
        """
        x = batch_dict["spatial_features_2d"]
        if tuple(x.shape[2:]) != self.map_shape:
            raise GeometryError(f"DENSE_HEAD: anchors lie on a map of {self.map_shape}, found {tuple(x.shape[2:])}")
        layers = [layer for layer in (self.conv_cls, self.conv_box, self.conv_dir_cls) if layer is not None]
        with convolutions():
            outputs = _convolved(layers, x)
        if "min_scores" in batch_dict and decode_kernel.picks(outputs, self.bins):
            how = self.num_class, self.bins, self.anchors, self.direction_offset, batch_dict["min_scores"]
            logits, boxes = decode_kernel.likely_boxes(outputs, *how)
            likely = {"batch_cls_preds": logits, "batch_box_preds": boxes, "cls_preds_normalized": False}
            return {**batch_dict, **likely}
        outputs = _by_layer(outputs, layers)
        scores, codes, *directions = outputs if torch.is_grad_enabled() else map(full_precision, outputs)
        out = {"cls_preds": per_anchor(scores, self.num_class), "box_preds": per_anchor(codes, 7)}
        out["dir_cls_preds"] = per_anchor(*directions, self.bins) if directions else None
        if not self.training or self.predict_when_training:
            out["batch_cls_preds"], out["cls_preds_normalized"] = out["cls_preds"].float(), False
            out["batch_box_preds"] = self.decode(out["box_preds"].float(), out["dir_cls_preds"])
        return {**batch_dict, **out}

    def decode(self, codes: Tensor, directions: Tensor | None) -> Tensor:
        """Codes (B, A, 7) and direction logits (B, A, bins) -> boxes (B, A, 7)."""
        if decode_kernel.fits(codes, directions, self.anchors):
            return decode_kernel.decode(codes, directions, self.anchors, self.direction_offset)
        boxes = decode(codes, self.anchors)
        if directions is None:
            return boxes
        heading = turn_into_sector(boxes[..., 6], directions.argmax(-1), self.direction_offset, self.bins)
        return torch.cat([boxes[..., :6], heading[..., None]], -1)

    def get_loss(self, batch_dict: dict) -> tuple[Tensor, dict]:
        """Needs the raw outputs of ``forward`` and gt_boxes (B, M, 8)."""
        labels, box_index = self.assign_targets(batch_dict["gt_boxes"])
        positives = torch.stack([(labels == k + 1).sum() for k in range(len(self.classes))])
        normaliser = shared_normaliser(positives)
        cls_loss = self.cls_weight * self._score_loss(batch_dict["cls_preds"].float(), labels, normaliser)
        loc_loss, dir_loss = self._positive_losses(batch_dict, labels, box_index, normaliser)
        loss = cls_loss + self.loc_weight * loc_loss + self.dir_weight * dir_loss
        terms = {"rpn_loss_cls": cls_loss, "rpn_loss_loc": self.loc_weight * loc_loss}
        terms |= {"rpn_loss_dir": self.dir_weight * dir_loss, "rpn_loss": loss}
        return loss, {name: term.detach() for name, term in terms.items()}

    @torch.no_grad()
    def assign_targets(self, gt_boxes: Tensor) -> tuple[Tensor, Tensor]:
        """gt_boxes (B, M, 8) -> labels (B, A) as in ``Assignment``, and the row of gt_boxes for every anchor (B, A)."""
        check_targets(gt_boxes, self.num_class)
        samples = [self._assign_sample(boxes) for boxes in gt_boxes]
        return torch.stack([s.labels for s in samples]), torch.stack([s.box_index for s in samples])

    def _assign_sample(self, gt_boxes: Tensor) -> Assignment:
        labels, indices = [], []
        for k, spec in enumerate(self.classes):
            rows = (gt_boxes[:, 7] == k + 1).nonzero().squeeze(1)
            x, y, boxes = (getattr(self, f"anchor_{name}_{k}") for name in ("x", "y", "boxes"))
            found = assign(x, y, boxes, gt_boxes[rows, :7], k + 1, spec.matched, spec.unmatched)
            labels.append(found.labels)
            indices.append(rows[found.box_index] if len(rows) else found.box_index)
        return Assignment(torch.cat(labels, 2).flatten(), torch.cat(indices, 2).flatten())

    def _score_loss(self, logits: Tensor, labels: Tensor, normaliser: Tensor) -> Tensor:
        targets = F.one_hot(labels.clamp(min=0), self.num_class + 1)[..., 1:].to(logits.dtype)
        weight = (1 / normaliser)[self.anchor_class].repeat(labels.shape[1] // len(self.anchor_class))  # (A,)
        per_anchor = sigmoid_focal_loss(logits, targets).sum(-1)
        return (per_anchor * weight * (labels >= 0)).sum()

    def _positive_losses(
        self, batch_dict: dict, labels: Tensor, box_index: Tensor, normaliser: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Box and direction loss over the positive anchors (N of them)."""
        sample, anchor = (labels > 0).nonzero(as_tuple=True)
        own_class = labels[sample, anchor] - 1
        anchors = self.anchors[anchor]
        targets = batch_dict["gt_boxes"][sample, box_index[sample, anchor], :7].float()
        weight, heading_weight = 1 / normaliser[own_class], self.heading_weights[own_class]
        code_weights = self.code_weights.repeat(len(anchor), 1)
        code_weights[:, 6] *= heading_weight
        codes = batch_dict["box_preds"][sample, anchor].float()
        loc_loss = (box_loss(codes, encode(targets, anchors), code_weights).sum(1) * weight).sum()
        if not self.bins:
            return loc_loss, loc_loss.new_zeros(())
        sector = direction_class(targets[:, 6], self.direction_offset, self.bins)
        logits = batch_dict["dir_cls_preds"][sample, anchor].float()
        per_box = F.cross_entropy(logits, sector, reduction="none")
        return loc_loss, (per_box * weight * heading_weight).sum()


def convolve_together(layers: Sequence[nn.Conv2d], x: Tensor) -> tuple[Tensor, ...]:
    """The results of 1 x 1 convolutions of the same map (B, C, H, W), which is read once."""
    return _by_layer(_convolved(layers, x), layers)


def _convolved(layers: Sequence[nn.Conv2d], x: Tensor) -> Tensor:
    """The channels of all results, one layer after the other."""
    weight, bias = (torch.cat([getattr(layer, name) for layer in layers]) for name in ("weight", "bias"))
    return convolve_to_cells_last(x, weight, bias)


def _by_layer(outputs: Tensor, layers: Sequence[nn.Conv2d]) -> tuple[Tensor, ...]:
    return outputs.split([layer.out_channels for layer in layers], 1)


def per_anchor(x: Tensor, values: int) -> Tensor:
    """(B, K * values, H, W) -> (B, H * W * K, values)."""
    return x.permute(0, 2, 3, 1).reshape(len(x), -1, values)


def anchor_classes(model_cfg: Any, class_names: Sequence[str]) -> list[AnchorClass]:
    """The anchors of every class, in the order of ``class_names`` (the order of labels).

    Entries of other classes stand for nothing: CLASS_NAMES says what is detected, so that ``--set CLASS_NAMES "[Car]"``
    is enough where the data have no pedestrians among their labels.
    """
    entries = list(model_cfg["ANCHOR_GENERATOR_CONFIG"])
    specs = {cfg["class_name"]: AnchorClass.from_config(cfg) for cfg in entries}
    if len(specs) != len(entries):
        names = [cfg["class_name"] for cfg in entries]
        twice = next(name for name in names if names.count(name) > 1)
        raise ConfigError(
            f"DENSE_HEAD.ANCHOR_GENERATOR_CONFIG: two entries for {twice!r}; put all its sizes into one entry's "
            "anchor_sizes, and its headings into anchor_rotations"
        )
    if not set(specs) >= set(class_names):
        raise ConfigError(f"DENSE_HEAD: anchors for {sorted(specs)}, but the classes are {list(class_names)}")
    return [specs[name] for name in class_names]


def feature_map_stride(model_cfg: Any) -> int:
    """Cells of the BEV grid per cell of the head's map; the same for all classes."""
    strides = {int(cfg.get("feature_map_stride", 1)) for cfg in model_cfg["ANCHOR_GENERATOR_CONFIG"]}
    if len(strides) != 1:
        raise ConfigError(f"DENSE_HEAD: feature_map_stride must be the same for all classes, found {sorted(strides)}")
    return strides.pop()


def grid_of(point_cloud_range: Any, grid_size: Any) -> BevGrid:
    """The grid with ``grid_size`` (columns, rows, ...) cells on this range."""
    limits = [float(v) for v in point_cloud_range]
    return BevGrid(*limits, cell_m=(limits[3] - limits[0]) / int(grid_size[0]))
