"""PointPillars' multi-scale BEV backbone (PointPillars, section 2.2), with OpenPCDet's module names and keys."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from pcdet_avp.errors import ConfigError, GeometryError
from pcdet_avp.models.memory_layout import for_convolutions
from pcdet_avp.models.norm import make_norm, norm_relu
from pcdet_avp.models.pointwise import BlockConvTranspose2d, PointwiseConvTranspose2d
from pcdet_avp.models.precision import convolutions
from pcdet_avp.registry import BACKBONES_2D


@BACKBONES_2D.register("BaseBEVBackbone")
class BaseBEVBackbone(nn.Module):
    """Stages of strided 3x3 convolutions (``blocks.i``), each brought to a common size (``deblocks.i``) and joined.

    Keys: LAYER_NUMS, LAYER_STRIDES, NUM_FILTERS per stage; UPSAMPLE_STRIDES, NUM_UPSAMPLE_FILTERS per stage;
    NORM ``group`` (default) or ``batch``.
    """

    def __init__(self, model_cfg: Any, input_channels: int) -> None:
        super().__init__()
        layers, strides, filters = (list(model_cfg[k]) for k in ("LAYER_NUMS", "LAYER_STRIDES", "NUM_FILTERS"))
        ups, up_filters = list(model_cfg["UPSAMPLE_STRIDES"]), list(model_cfg["NUM_UPSAMPLE_FILTERS"])
        norm = model_cfg.get("NORM", "group")
        self.output_stride = _common_stride(layers, strides, filters, ups, up_filters)
        inputs = [input_channels, *filters[:-1]]
        stages = zip(inputs, filters, layers, strides, strict=True)
        self.blocks = nn.ModuleList(conv_stage(*stage, norm) for stage in stages)
        self.deblocks = nn.ModuleList(upsample(*up, norm) for up in zip(filters, up_filters, ups, strict=True))
        self.num_bev_features = sum(up_filters)
        self._divisor = 1
        for stride in strides:
            self._divisor *= stride

    def forward(self, batch_dict: dict) -> dict:
        """
        Args: batch_dict:
            spatial_features (B, C, H, W)
        Returns: batch_dict with
            spatial_features_2d (B, num_bev_features, H / output_stride, W / output_stride)
        """
        return {**batch_dict, "spatial_features_2d": self.encode(batch_dict["spatial_features"])}

    def encode(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, num_bev_features, H', W'), in bf16 where convolutions are (``models.precision``)."""
        if x.shape[2] % self._divisor or x.shape[3] % self._divisor:
            raise GeometryError(f"BACKBONE_2D: a map of {x.shape[2]} x {x.shape[3]} does not divide by {self._divisor}")
        x = for_convolutions(x)
        scales = []
        with convolutions():
            for block, deblock in zip(self.blocks, self.deblocks, strict=True):
                x = block(x)
                scales.append(deblock(x))
            return torch.cat(scales, 1)


class ConvStage(nn.Sequential):
    """Convolutions, each with norm and ReLU behind it, which are computed in one where that serves."""

    def forward(self, x: Tensor) -> Tensor:
        """x (B, C, h, w) -> (B, C_out, h / stride, w / stride)."""
        layers = list(self)
        if isinstance(layers[0], nn.Identity):
            del layers[0]
        for conv, norm in zip(layers[0::3], layers[1::3], strict=True):
            x = norm_relu(norm, conv(x))
        return x


def conv_stage(inputs: int, outputs: int, layers: int, stride: int, norm: str) -> ConvStage:
    """One strided 3x3 convolution and ``layers`` more; each with norm and ReLU.

    The first place, where OpenPCDet pads, is kept for the names' sake; the convolution pads.
    """
    modules = [nn.Identity()]
    for i in range(layers + 1):
        conv = nn.Conv2d(outputs if i else inputs, outputs, 3, stride=1 if i else stride, padding=1, bias=False)
        modules += [conv, make_norm(norm, outputs), nn.ReLU(inplace=True)]
    return ConvStage(*modules)


def upsample(inputs: int, outputs: int, stride: float, norm: str) -> ConvStage:
    """Enlarge a map ``stride`` times without overlap, or shrink it where the stride is below 1."""
    if stride == 1:
        conv = PointwiseConvTranspose2d(inputs, outputs)
    elif stride > 1:
        conv = BlockConvTranspose2d(inputs, outputs, round(stride))
    else:
        conv = nn.Conv2d(inputs, outputs, round(1 / stride), stride=round(1 / stride), bias=False)
    return ConvStage(conv, make_norm(norm, outputs), nn.ReLU(inplace=True))


def _common_stride(layers: list, strides: list, filters: list, ups: list, up_filters: list) -> int:
    """Cells of the input per cell of the output along one axis; every stage must lead to the same."""
    lengths = [len(v) for v in (layers, strides, filters, ups, up_filters)]
    if len(set(lengths)) != 1 or not lengths[0]:
        raise ConfigError(f"BACKBONE_2D: the five lists need one entry per stage, found lengths {lengths}")
    total, outputs = 1, []
    for stride, up in zip(strides, ups, strict=True):
        total *= stride
        outputs.append(total / up)
    if len(set(outputs)) != 1:
        raise ConfigError(f"BACKBONE_2D: UPSAMPLE_STRIDES {ups} bring the stages to unequal strides {outputs}")
    return round(outputs[0])
