"""Deformable self-attention on a bird's-eye-view map (Deformable DETR, Zhu et al. 2021, single scale).

Every operation keeps an empty neighbourhood exactly zero, so that the map stays sparse for the compression: values,
outputs and the feed-forward part have no bias, and the normalisation only scales. Queries may have biases, since
they decide where to look and not what is seen.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pcdet_avp.errors import ConfigError
from pcdet_avp.models.cpu_kernels import attention as kernels
from pcdet_avp.models.cpu_kernels import attention_gradient
from pcdet_avp.models.cpu_kernels.dispatch import usable, usable_in_training
from pcdet_avp.models.norm import ScaleNorm
from pcdet_avp.models.precision import full_precision


class DeformableBevAttention(nn.Module):
    """x + attention(norm(x)), then x + feed_forward(norm(x)); absent cells are not seen and stay zero.

    Each of HEADS heads of a query cell reads its C / HEADS channels at POINTS places: the cell's own place plus a
    learned offset in cells, which starts on a ring (head = direction, point = distance). The places are weighed by
    a softmax. QUERY_STRIDE 2 asks once per 2 x 2 cells and gives all four the answer, at a quarter of the cost.
    FFN_CHANNELS is the hidden width of the feed-forward part. Both residual branches start at zero.
    """

    def __init__(self, model_cfg: Any, channels: int) -> None:
        super().__init__()
        self.heads, self.points = int(model_cfg.get("HEADS", 4)), int(model_cfg.get("POINTS", 4))
        self.stride = int(model_cfg.get("QUERY_STRIDE", 1))
        if channels % self.heads:
            raise ConfigError(f"ATTENTION.HEADS: {channels} channels do not divide by {self.heads} heads")
        hidden = int(model_cfg.get("FFN_CHANNELS", channels))
        self.norm, self.ffn_norm = ScaleNorm(channels), ScaleNorm(channels)
        self.value = nn.Linear(channels, channels, bias=False)
        self.offsets = nn.Linear(channels, self.heads * self.points * 2)
        self.scores = nn.Linear(channels, self.heads * self.points)
        self.output = nn.Linear(channels, channels, bias=False)
        self.ffn_in = nn.Linear(channels, hidden, bias=False)
        self.ffn_out = nn.Linear(hidden, channels, bias=False)
        self._initialise()

    def _initialise(self) -> None:
        for layer in (self.offsets, self.scores, self.output, self.ffn_out):
            nn.init.zeros_(layer.weight)
        nn.init.zeros_(self.scores.bias)
        with torch.no_grad():
            self.offsets.bias.copy_(ring_offsets(self.heads, self.points).view(-1))

    def forward(self, x: Tensor, present: Tensor) -> Tensor:
        """x (B, C, H, W), present (B, 1, H, W) bool -> (B, C, H, W), zero where absent."""
        if x.shape[2] % self.stride or x.shape[3] % self.stride:
            raise ConfigError(f"ATTENTION.QUERY_STRIDE: {tuple(x.shape[2:])} cells do not divide by {self.stride}")
        if usable(x, self.value.weight):
            return kernels.attend(self, x, present)
        if usable_in_training(x, self.value.weight) and len(x):
            return attention_gradient.attend(self, x, present)
        inside = present.to(x.dtype)
        x = x * inside
        x = torch.addcmul(x, self._attend(x, self.norm.scale(x, present)), inside)
        return x + self._feed_forward(x, self.ffn_norm.scale(x, present))

    def _feed_forward(self, x: Tensor, scale: Tensor) -> Tensor:
        hidden = F.relu(scaled_linear(x, scale, self.ffn_in.weight), inplace=True)
        return self.ffn_out(hidden).view(len(x), *x.shape[2:], -1).permute(0, 3, 1, 2)

    def _attend(self, x: Tensor, scale: Tensor) -> Tensor:
        b, _, height, width = x.shape
        values = scaled_linear(x, scale, self.value.weight).view(b, height, width, self.heads, -1)
        query = (F.avg_pool2d(x, self.stride) if self.stride > 1 else x).permute(0, 2, 3, 1)
        query = query * scale.to(x.dtype)[:, None, None]
        shape = (*query.shape[:3], self.heads, self.points)
        places = self.offsets(query).view(*shape, 2) + self._centres(query)
        scores = (
            self.scores(query).view(shape).movedim(-1, 0).softmax(0).movedim(0, -1)
        )  # a tenth of softmax(-1)'s time
        seen = deformable_sum(values, places, scores)
        answer = self.output(seen.to(x.dtype).flatten(3)).to(x.dtype).permute(0, 3, 1, 2)
        return F.interpolate(answer, scale_factor=self.stride, mode="nearest") if self.stride > 1 else answer

    def _centres(self, query: Tensor) -> Tensor:
        """(h, w, 1, 1, 2) column and row of the queries' places, in cells; a cell's centre is a whole number."""
        _, h, w, _ = query.shape
        rows, cols = (torch.arange(n, device=query.device) * self.stride + (self.stride - 1) / 2 for n in (h, w))
        grid = torch.stack(torch.broadcast_tensors(cols, rows[:, None]), -1)
        return grid[:, :, None, None]


def scaled_linear(x: Tensor, scale: Tensor, weight: Tensor) -> Tensor:
    """x (B, C, H, W), scale (B, C), weight (C_out, C) -> (B, H * W, C_out), a linear layer without bias of x * scale.

    The scale goes into the weights, so that the scaled map is never written.
    """
    return x.permute(0, 2, 3, 1).flatten(1, 2) @ (weight * scale[:, None]).to(x.dtype).transpose(1, 2)


def ring_offsets(heads: int, points: int) -> Tensor:
    """(heads, points, 2) cells along x and y: point k of head m lies k + 1 cells away, in the head's direction."""
    angle = torch.arange(heads) * (2 * math.pi / heads)
    direction = torch.stack([angle.cos(), angle.sin()], -1)
    direction = direction / direction.abs().amax(-1, keepdim=True)
    return direction[:, None] * torch.arange(1, points + 1)[None, :, None]


def deformable_sum(values: Tensor, places: Tensor, scores: Tensor) -> Tensor:
    """Weighted sums of bilinear samples, zero outside the map.

    values (B, H, W, M, d), places (B, h, w, M, K, 2) column and row in cells, scores (B, h, w, M, K)
    -> (B, h, w, M, d), at least in float32, whatever precision is automatic around it. Heads are images of their own.
    """
    with torch.autocast(values.device.type, enabled=False):
        values, places, scores = (full_precision(t) for t in (values, places, scores))
        if torch.is_grad_enabled() or torch.compiler.is_compiling():  # GridSample is what ONNX has
            return _sum_of_samples(values, places, scores)
        return _bag_sum(values, places, scores)


def _sum_of_samples(values: Tensor, places: Tensor, scores: Tensor) -> Tensor:
    """``deformable_sum`` with ``grid_sample``, whose backward pass is the faster one."""
    b, height, width, heads, d = values.shape
    h, w, points = scores.shape[1], scores.shape[2], scores.shape[4]
    images = values.permute(0, 3, 4, 1, 2).reshape(b * heads, d, height, width)
    size = places.new_tensor([width, height])
    grid = places * (2 / size) + (1 / size - 1)  # the outer borders of the map are -1 and 1
    grid = grid.permute(0, 3, 1, 2, 4, 5).reshape(b * heads, h * w, points, 2)
    samples = F.grid_sample(images, grid, align_corners=False)
    scores = scores.permute(0, 3, 1, 2, 4).reshape(b * heads, 1, h * w, points)
    return (samples * scores).sum(-1).view(b, heads, d, h, w).permute(0, 3, 4, 1, 2)


def _bag_sum(values: Tensor, places: Tensor, scores: Tensor) -> Tensor:
    """``deformable_sum`` in a quarter of the time, without a backward pass: the corners of all samples are one bag.

    Zeros around the map, one cell before and two behind, give every place four neighbours.
    """
    b, height, width, heads, d = values.shape
    table = F.pad(values, (0, 0, 0, 0, 1, 2, 1, 2))
    step, rows = heads * (width + 3), height + 3  # table rows of (map row, column, head)
    x, y = (places[..., i].clamp(-1, n) + 1 for i, n in enumerate((width, height)))  # (b, h, w, M, K) each
    left, top = x.int(), y.int()  # rounded down, as neither is negative
    first = left.mul_(heads).add_(top * step)
    sample, head = (torch.arange(n, device=values.device, dtype=torch.int32) for n in (b, heads))
    first += sample.view(b, 1, 1, 1, 1) * (rows * step) + head[:, None]
    right, lower = x.frac_(), y.frac_()
    lower_score = lower * scores
    upper_score = scores - lower_score
    shares = scores.new_empty(*scores.shape, 4)  # upper left, upper right, lower left, lower right
    for corner, score in ((0, upper_score), (2, lower_score)):
        torch.mul(score, right, out=shares[..., corner + 1])
        torch.sub(score, shares[..., corner + 1], out=shares[..., corner])
    cells = first[..., None] + first.new_tensor([0, heads, step, step + heads])
    cells, shares = (part.view(-1, 4 * scores.shape[-1]) for part in (cells, shares))
    return F.embedding_bag(cells, table.view(-1, d), per_sample_weights=shares, mode="sum").view(*scores.shape[:-1], d)
