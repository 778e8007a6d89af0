"""Residual networks (He et al. 2016) whose state dicts have torchvision's names, so that its weights load."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor, nn
from torch.nn import functional as F

from pcdet_avp.errors import ConfigError
from pcdet_avp.models.memory_layout import for_convolutions
from pcdet_avp.models.norm import make_norm, norm_relu
from pcdet_avp.models.pointwise import PointwiseConv2d
from pcdet_avp.models.side_by_side import take_all_cores

# Blocks per stage and kind of block, by the depth of the published networks.
DEPTHS = {18: ((2, 2, 2, 2), "basic"), 34: ((3, 4, 6, 3), "basic"), 50: ((3, 4, 6, 3), "bottleneck")}
PATCH = 4  # image pixels per side of a patch, the stride of the published stem
IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class ResNet(nn.Module):
    """Images (B, 3, h, w) -> feature maps of its stages, at strides 4, 8, 16, 32 (sizes rounded up)."""

    def __init__(
        self, blocks: Sequence[int], widths: Sequence[int], block: str, norm: str, stem: int = 64, patches: bool = False
    ) -> None:
        """``stem`` channels; ``patches``: a ``PatchStem`` instead of the published convolution and max pooling."""
        super().__init__()
        if block not in BLOCKS or len(blocks) != len(widths) or not 1 <= len(blocks) <= 4:
            raise ConfigError(
                f"ResNet: expected block in {sorted(BLOCKS)} and 1 to 4 stages with as many widths as block counts, "
                f"found {block!r}, {list(blocks)}, {list(widths)}"
            )
        self.patch_stem = PatchStem(stem, norm) if patches else None
        if not patches:
            self.conv1 = nn.Conv2d(3, stem, 7, stride=2, padding=3, bias=False)
            self.bn1 = make_norm(norm, stem)
        channels = [stem, *(width * BLOCKS[block].expansion for width in widths)]
        self.num_stages, self.out_channels = len(blocks), channels[1:]
        for i, (count, width) in enumerate(zip(blocks, widths, strict=True)):
            strides = [1 if i == 0 else 2] + [1] * (count - 1)
            inputs = [channels[i]] + [channels[i + 1]] * (count - 1)
            stage = [BLOCKS[block](n, width, stride, norm) for n, stride in zip(inputs, strides, strict=True)]
            self.add_module(f"layer{i + 1}", nn.Sequential(*stage))

    def forward(self, images: Tensor) -> list[Tensor]:
        """images (B, 3, h, w), normalised -> a map (B, C_i, h_i, w_i) of each stage, the finest first."""
        return self.behind_stem(self._stem(images))

    def behind_stem(self, x: Tensor) -> list[Tensor]:
        """The stages' maps of what the stem made."""
        stages = []
        for i in range(self.num_stages):
            if i == 2:  # about as long as the same frame's point cloud takes beside it
                take_all_cores()
            x = getattr(self, f"layer{i + 1}")(x)
            stages.append(x)
        return stages

    def _stem(self, images: Tensor) -> Tensor:
        if self.patch_stem is not None:
            return self.patch_stem(images)
        return F.max_pool2d(norm_relu(self.bn1, self.conv1(images)), 3, stride=2, padding=1)


class PatchStem(nn.Module):
    """Images (B, 3, h, w) -> (B, channels, ceil(h / 4), ceil(w / 4)): patches of 4 x 4 pixels become channels, then a
    3 x 3 convolution. No larger map is ever formed, and no pixel's place in its patch is lost to a maximum."""

    def __init__(self, channels: int, norm: str) -> None:
        super().__init__()
        self.conv = nn.Conv2d(3 * PATCH**2, channels, 3, padding=1, bias=False)
        self.norm = make_norm(norm, channels)

    def forward(self, images: Tensor) -> Tensor:
        """images (B, 3, h, w) -> (B, channels, ceil(h / 4), ceil(w / 4))."""
        below, right = (-n % PATCH for n in images.shape[2:])
        return self.of_patches(for_convolutions(F.pixel_unshuffle(F.pad(images, (0, right, 0, below)), PATCH)))

    def of_patches(self, patches: Tensor) -> Tensor:
        """(B, 48, h', w') -> (B, channels, h', w')."""
        return norm_relu(self.norm, self.conv(patches))


class BasicBlock(nn.Module):
    """Two 3 x 3 convolutions and a shortcut."""

    expansion = 1

    def __init__(self, inputs: int, width: int, stride: int, norm: str) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, width, 3, stride, 1, bias=False)
        self.bn1 = make_norm(norm, width)
        self.conv2 = nn.Conv2d(width, width, 3, 1, 1, bias=False)
        self.bn2 = make_norm(norm, width)
        self.downsample = _shortcut(inputs, width, stride, norm)

    def forward(self, x: Tensor) -> Tensor:
        """x (B, inputs, h, w) -> (B, width * expansion, ceil(h / stride), ceil(w / stride))."""
        shortcut = x if self.downsample is None else self.downsample(x)
        out = norm_relu(self.bn1, self.conv1(x))
        return norm_relu(self.bn2, self.conv2(out), shortcut)


class Bottleneck(nn.Module):
    """1 x 1, 3 x 3 (which strides, as in torchvision) and 1 x 1 convolutions and a shortcut."""

    expansion = 4

    def __init__(self, inputs: int, width: int, stride: int, norm: str) -> None:
        super().__init__()
        outputs = width * self.expansion
        self.conv1 = PointwiseConv2d(inputs, width, bias=False)
        self.bn1 = make_norm(norm, width)
        self.conv2 = nn.Conv2d(width, width, 3, stride, 1, bias=False)
        self.bn2 = make_norm(norm, width)
        self.conv3 = PointwiseConv2d(width, outputs, bias=False)
        self.bn3 = make_norm(norm, outputs)
        self.downsample = _shortcut(inputs, outputs, stride, norm)

    def forward(self, x: Tensor) -> Tensor:
        """x (B, inputs, h, w) -> (B, width * expansion, ceil(h / stride), ceil(w / stride))."""
        shortcut = x if self.downsample is None else self.downsample(x)
        out = norm_relu(self.bn1, self.conv1(x))
        out = norm_relu(self.bn2, self.conv2(out))
        return norm_relu(self.bn3, self.conv3(out), shortcut)


BLOCKS = {"basic": BasicBlock, "bottleneck": Bottleneck}


def _shortcut(inputs: int, outputs: int, stride: int, norm: str) -> nn.Sequential | None:
    if stride == 1 and inputs == outputs:
        return None
    return nn.Sequential(PointwiseConv2d(inputs, outputs, stride, bias=False), make_norm(norm, outputs))
