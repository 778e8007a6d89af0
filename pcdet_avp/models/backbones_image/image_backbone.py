"""Image features at stride 4: a residual network and a feature pyramid that brings its deep stages up."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pcdet_avp.errors import ConfigError
from pcdet_avp.models.backbones_image.resnet import DEPTHS, IMAGENET_MEAN, IMAGENET_STD, PATCH, ResNet
from pcdet_avp.models.cpu_kernels import patches
from pcdet_avp.models.memory_layout import for_convolutions
from pcdet_avp.models.norm import drop_foreign_norms, make_norm, norm_relu
from pcdet_avp.models.pointwise import PointwiseConv2d
from pcdet_avp.models.weights.checkpoint_file import UNREADABLE

STRIDE = 4  # image pixels per side of a feature pixel
STEM_KINDS = ("conv", "patches")
BOOKKEEPING = "num_batches_tracked"  # of batch norms; nothing computes with it


class ImageBackbone(nn.Module):
    """Images (B, 3, h, w), RGB in [0, 1] -> features (B, OUT_CHANNELS, ceil(h / 4), ceil(w / 4)).

    ``DEPTH: 18 | 34 | 50`` is the published network; where it is null, ``BLOCKS``, ``WIDTHS``, ``BLOCK`` (basic or
    bottleneck), ``STEM`` channels and ``STEM_KIND`` (conv or patches, see ``PatchStem``) describe a lighter one.
    ``NORM`` is group, batch or frozen_batch. ``PRETRAINED`` names a file with torchvision's ImageNet weights, or is
    null.
    """

    def __init__(self, model_cfg: Any) -> None:
        super().__init__()
        norm = model_cfg.get("NORM", "group")
        self.resnet = _resnet(model_cfg, norm)
        self.neck = FeaturePyramid(self.resnet.out_channels, int(model_cfg.OUT_CHANNELS), norm)
        self.out_channels = int(model_cfg.OUT_CHANNELS)
        if model_cfg.get("PRETRAINED"):
            load_imagenet_weights(self.resnet, model_cfg.PRETRAINED)
        self.register_buffer("mean", torch.tensor(IMAGENET_MEAN).view(3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(IMAGENET_STD).view(3, 1, 1), persistent=False)

    def forward(self, images: Tensor) -> Tensor:
        """images (B, 3, h, w) in [0, 1] -> features (B, OUT_CHANNELS, ceil(h / 4), ceil(w / 4))."""
        stem = self.resnet.patch_stem
        if stem is not None and patches.fits(images):
            x = stem.of_patches(patches.normalised_patches(images, self.mean, self.std, PATCH))
            return self.neck(self.resnet.behind_stem(x))
        images = (images - self.mean) / self.std
        return self.neck(self.resnet(for_convolutions(images)))


class FeaturePyramid(nn.Module):
    """Sum of all stages at the first one's resolution (Lin et al. 2017, finest level only), then a 3 x 3 convolution.

    The 1 x 1 convolutions stand before the upsampling, which then costs less and gives the same.
    """

    def __init__(self, in_channels: Sequence[int], out_channels: int, norm: str) -> None:
        super().__init__()
        self.lateral = nn.ModuleList(PointwiseConv2d(n, out_channels) for n in in_channels)
        self.smooth = nn.Conv2d(out_channels, out_channels, 3, padding=1, bias=False)
        self.norm = make_norm(norm, out_channels)

    def forward(self, stages: list[Tensor]) -> Tensor:
        """Maps (B, C_i, h_i, w_i), the finest first -> (B, out_channels, h_0, w_0)."""
        x = self.lateral[-1](stages[-1])
        for lateral, stage in zip(self.lateral[-2::-1], stages[-2::-1], strict=True):
            x = lateral(stage) + F.interpolate(x, size=stage.shape[-2:], mode="bilinear", align_corners=False)
        return norm_relu(self.norm, self.smooth(x))


def _resnet(model_cfg: Any, norm: str) -> ResNet:
    if model_cfg.get("DEPTH") is None:
        kind = model_cfg.get("STEM_KIND", "conv")
        if kind not in STEM_KINDS:
            raise ConfigError(f"IMAGE_BACKBONE.STEM_KIND: expected one of {', '.join(STEM_KINDS)}, found {kind!r}")
        block, stem = model_cfg.get("BLOCK", "basic"), int(model_cfg.STEM)
        return ResNet(model_cfg.BLOCKS, model_cfg.WIDTHS, block, norm, stem, patches=kind == "patches")
    if model_cfg.DEPTH not in DEPTHS:
        raise ConfigError(f"IMAGE_BACKBONE.DEPTH: expected one of {sorted(DEPTHS)}, found {model_cfg.DEPTH}")
    blocks, block = DEPTHS[model_cfg.DEPTH]
    return ResNet(blocks, (64, 128, 256, 512), block, norm)


def load_imagenet_weights(resnet: ResNet, path: str | os.PathLike) -> list[str]:
    """Load torchvision's state dict from a file; returns the names that could not be used.

    The classifier is not ours. Under group norm the batch norms' affine parts are left out: they belong to statistics
    that group norm does not have. Anything else that does not fit is a ConfigError.
    """
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, *UNREADABLE) as error:
        raise ConfigError(f"{path}: cannot be read as a state dict ({error})") from error
    kept, dropped = drop_foreign_norms(state, resnet)
    own = resnet.state_dict()
    unused = [key for key in kept if key.startswith("fc.") or key.endswith(BOOKKEEPING)]
    kept = {key: value for key, value in kept.items() if key not in unused}
    for key, value in kept.items():
        if key not in own or own[key].shape != value.shape:
            found = "nothing of that name" if key not in own else f"shape {tuple(own[key].shape)}"
            raise ConfigError(f"{path}: {key} has shape {tuple(value.shape)}, the configured network has {found}")
    missing = [key for key in own if key not in kept and key not in dropped and not key.endswith(BOOKKEEPING)]
    if missing:
        raise ConfigError(f"{path}: lacks {missing[0]} and {len(missing) - 1} more of the configured network")
    resnet.load_state_dict(kept, strict=False)
    return dropped + unused
