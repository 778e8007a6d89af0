"""AdaFusion in training: ``fusion.ada_fusion`` with a backward pass of three passes over the maps.

The two perceptrons see a few numbers of each sample; their gradients are torch's own, of the same layers once more.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from pcdet_avp.models.cpu_kernels import fusion
from pcdet_avp.models.cpu_kernels.dispatch import array_of, as_map, cells_last
from pcdet_avp.models.cpu_kernels.fusion_passes import (
    add_to_maps,
    convolve_gradients,
    first_place_of,
    mixture_gradients,
    products,
)

NO_MAP = np.zeros((0, 0, 0), np.float32)


def ada_fusion(fuser: nn.Module, maps: dict[int, Tensor], masks: dict[int, Tensor]) -> Tensor:
    """What ``AdaFusion.fuse`` computes of maps (B, C, H, W), whatever stands in absent cells; masks (B, 1, H, W)."""
    return _AdaFusion.apply(fuser, list(maps), *maps.values(), *masks.values(), *_parameters(fuser))


def _parameters(fuser: nn.Module) -> list[nn.Parameter]:
    conv, layers = fuser.spatial.conv, [*_perceptron(fuser.channel), *_perceptron(fuser.combine)]
    return [conv.weight, conv.bias, *layers]


def _perceptron(fusion_of_maps: nn.Module) -> list[nn.Parameter]:
    return [fusion_of_maps.hidden.weight, fusion_of_maps.weights.weight]


class _AdaFusion(torch.autograd.Function):
    @staticmethod
    def forward(ctx, fuser: nn.Module, slots: list[int], *tensors: Tensor) -> Tensor:
        maps, masks = tensors[: len(slots)], tensors[len(slots) : 2 * len(slots)]
        out = np.empty(cells_last(maps[0]).shape, np.float32)
        samples = fusion.samples_of(dict(zip(slots, maps, strict=True)), dict(zip(slots, masks, strict=True)), fuser)
        kept = [fusion.fuse_sample(fuser, *sample, out[i]) for i, sample in enumerate(samples)]
        ctx.fuser, ctx.slots = fuser, slots
        ctx.save_for_backward(*tensors, *(torch.from_numpy(a) for arrays in kept for a in arrays))
        return as_map(out)

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor) -> tuple:
        fuser, n = ctx.fuser, len(ctx.slots)
        parameters = _parameters(fuser)
        maps, masks, kept = (ctx.saved_tensors[a:b] for a, b in ((0, n), (n, 2 * n), (2 * n + len(parameters), None)))
        samples = fusion.samples_of(
            dict(zip(ctx.slots, maps, strict=True)), dict(zip(ctx.slots, masks, strict=True)), fuser
        )
        wanted, each = cells_last(grad), len(kept) // len(grad)
        d_maps = {slot: np.zeros(wanted.shape, np.float32) for slot in ctx.slots}
        d_parameters = [torch.zeros_like(p) for p in parameters]
        for i, (its_maps, its_masks) in enumerate(samples):
            d_its_maps = tuple(d_maps[slot][i] if slot in d_maps else NO_MAP for slot in range(len(its_maps)))
            arrays = [array_of(t) for t in kept[i * each : (i + 1) * each]]
            found = _sample_gradients(fuser, its_maps, its_masks, arrays, wanted[i], d_its_maps)
            for total, part in zip(d_parameters, found, strict=True):
                total += part
        return None, None, *(as_map(d) for d in d_maps.values()), *[None] * n, *d_parameters


def _sample_gradients(
    fuser: nn.Module, maps: tuple, masks: tuple, kept: list[np.ndarray], grad: np.ndarray, d_maps: tuple
) -> list[Tensor]:
    """One sample: writes d_maps (H, W, C), which are zero, for the gradient (H, W, C); those of the parameters."""
    highest, mean, mixed, mixed_highest, mixed_mean = kept
    present = np.logical_or.reduce(masks)
    d_shares, values = products(mixed, present, grad), max(int(present.sum()) * grad.shape[2], 1)
    shares, d_top, d_mean, d_combine = _perceptron_gradients(fuser.combine, mixed_highest, mixed_mean, d_shares, True)
    tops = np.array([first_place_of(mixed[:, :, k], present, mixed_highest[k]) for k in range(2)])
    wanted = shares, (d_mean / values).astype(np.float32), tops, d_top
    W = fuser.channel.map_weights(list(range(len(maps))), *(torch.from_numpy(a)[None] for a in (highest, mean)))
    W = array_of(W[0])
    d_pre, d_W = mixture_gradients(mixed, maps, masks, W, *wanted, grad, fuser.channel.original_form)
    _, d_top, d_mean, d_channel = _perceptron_gradients(fuser.channel, highest, mean, d_W, False)
    counts = np.array([max(int(mask.sum()) * grad.shape[2], 1) for mask in masks])
    kernel = array_of(fuser.spatial.conv.weight)[0].transpose(2, 3, 0, 1)  # row, column, map, channel shift
    flipped = np.ascontiguousarray(kernel[::-1, ::-1, :, ::-1]).reshape(9, 6)
    per_value, padded = (d_mean / counts).astype(np.float32), fusion.pool(maps, masks)
    add_to_maps(d_pre, padded, maps, masks, W, *wanted, grad, flipped, per_value, fuser.channel.original_form, d_maps)
    for n, mask in enumerate(masks):
        row, column, channel = first_place_of(maps[n], mask, highest[n])
        if row >= 0:
            d_maps[n][row, column, channel] += d_top[n]
    d_kernel = convolve_gradients(d_pre, padded).reshape(3, 3, 2, 3).transpose(2, 3, 0, 1)[None]
    d_bias = torch.from_numpy(d_pre).sum().view(1)
    return [torch.from_numpy(np.ascontiguousarray(d_kernel, np.float32)), d_bias, *d_channel, *d_combine]


def _perceptron_gradients(
    layers: nn.Module, highest: np.ndarray, mean: np.ndarray, grad: np.ndarray, as_shares: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[Tensor]]:
    """What ``map_weights`` makes of the maps' maxima and means (n,), as shares of one whole or as they are; and its
    gradients for that: of maxima and means (n,) and of both layers' weights."""
    with torch.enable_grad():
        leaves = [torch.from_numpy(a)[None].requires_grad_() for a in (highest, mean)]
        weights = [p.detach().requires_grad_() for p in _perceptron(layers)]
        names = ("hidden.weight", "weights.weight")
        W = _map_weights(layers, dict(zip(names, weights, strict=True)), *leaves)
        if as_shares and not layers.original_form:
            total = W.sum()
            W = torch.where(total > 0, W / total.clamp(min=float(fusion.EPS)), 1 / len(W))
        grads = torch.autograd.grad(W, [*leaves, *weights], torch.from_numpy(grad).to(W.dtype))
    d_highest, d_mean = (array_of(g[0]) for g in grads[:2])
    return array_of(W), d_highest, d_mean, list(grads[2:])


def _map_weights(layers: nn.Module, weights: dict[str, Tensor], highest: Tensor, mean: Tensor) -> Tensor:
    """``ChannelAdaFusion.map_weights`` of all slots with these weights of its layers: (n,)."""
    D = torch.stack([highest, mean], 1).flatten(1)
    hidden = torch.nn.functional.linear(D, weights["hidden.weight"]).sigmoid()
    return torch.nn.functional.linear(hidden, weights["weights.weight"]).relu()[0]
