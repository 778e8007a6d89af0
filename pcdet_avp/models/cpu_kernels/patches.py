"""Patches of normalised images at inference on a CPU: subtraction, division, padding and ``pixel_unshuffle`` in one."""

from __future__ import annotations

from functools import partial

import numba
import numpy as np
import torch
from torch import Tensor

from pcdet_avp.models.cpu_kernels.bfloat16 import bits_of, stored
from pcdet_avp.models.cpu_kernels.dispatch import OPTIONS, array_of, usable, usable_in_bf16
from pcdet_avp.models.side_by_side import in_bands


def fits(images: Tensor) -> bool:
    """Whether ``normalised_patches`` serves: images in float32."""
    return images.dtype == torch.float32 and (usable(images) or usable_in_bf16(images))


def normalised_patches(images: Tensor, mean: Tensor, std: Tensor, side: int) -> Tensor:
    """(images - mean) / std, filled with zero at the right and below, as (B, 3 * side^2, ceil(h / side),
    ceil(w / side)), channels last in memory; in bf16 where that is the automatic precision."""
    b, colours, height, width = images.shape
    dtype = torch.bfloat16 if torch.is_autocast_enabled("cpu") else torch.float32
    out = torch.empty((b, -(-height // side), -(-width // side), colours * side**2), dtype=dtype)
    of_colour = (t.flatten().numpy() for t in (mean, std))
    arrays = array_of(images), *of_colour, side, bits_of(out)
    in_bands(partial(_write_patches, *arrays), out.shape[1])
    return out.permute(0, 3, 1, 2)


@numba.njit(**OPTIONS)
def _write_patches(images, mean, std, side, out, begin, end):
    zero = np.float32(0)
    for sample in range(out.shape[0]):
        for row in range(max(begin, 0), end):
            for column in range(out.shape[2]):
                channel = 0
                for colour in range(images.shape[1]):
                    for i in range(side):
                        for j in range(side):
                            v, u = row * side + i, column * side + j
                            value = zero
                            if v < images.shape[2] and u < images.shape[3]:
                                value = (images[sample, colour, v, u] - mean[colour]) / std[colour]
                            out[sample, row, column, channel] = stored(out, value)
                            channel += 1
