"""Non-maximum suppression of upright boxes by the IoU of their footprints; no compiled extension.

On a CPU the survivors are found one after the other with numba's polygon clipping; on a GPU all overlaps are computed
at once and the same survivors follow from a few matrix products.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pcdet_avp.structures.rotated_iou import suppress


def rotated_nms(boxes: Tensor, scores: Tensor, threshold: float, pre_max: int, post_max: int) -> Tensor:
    """Rows of boxes (N, 7) that survive, best first: int64, at most ``post_max``.

    Only the ``pre_max`` best are looked at. A box goes when its IoU with a better survivor is above ``threshold``;
    of equal scores the earlier row is the better one.
    """
    order = scores.sort(descending=True, stable=True).indices[:pre_max]
    return order[suppressed(boxes[order], threshold, post_max)]


def suppressed(boxes: Tensor, threshold: float, post_max: int) -> Tensor:
    """As ``rotated_nms``, for boxes that are sorted by falling score already."""
    if boxes.is_cuda:
        return nms_on_gpu(boxes, threshold)[:post_max]
    return nms_on_cpu(boxes, threshold, post_max)


def nms_on_cpu(boxes: Tensor, threshold: float, post_max: int | None = None) -> Tensor:
    """Rows of boxes (N, 7), sorted by falling score, that survive; None: all of them."""
    most = len(boxes) if post_max is None else post_max
    return torch.from_numpy(suppress(boxes.detach().numpy(), threshold, most))


def nms_on_gpu(boxes: Tensor, threshold: float) -> Tensor:
    """As ``nms_on_cpu``; runs on any device.

    A box survives if no better survivor suppresses it. Since only better boxes matter, the statement applied over and
    over to a first guess settles from the top, and the settled state is the greedy result.
    """
    N = len(boxes)
    i, j = candidate_pairs(boxes)
    suppresses = torch.zeros(N, N, device=boxes.device)
    suppresses[i, j] = (pairwise_bev_iou(boxes[i], boxes[j]) > threshold).float()
    keep = torch.ones(N, device=boxes.device)
    while True:
        settled = (keep @ suppresses == 0).float()
        if torch.equal(settled, keep):
            return keep.nonzero().squeeze(1)
        keep = settled


def candidate_pairs(boxes: Tensor) -> tuple[Tensor, Tensor]:
    """Rows i < j of boxes (N, 7) whose circumscribed circles meet."""
    radius = torch.linalg.vector_norm(boxes[:, 3:5], dim=1) / 2
    distance = torch.cdist(boxes[None, :, :2], boxes[None, :, :2], compute_mode="donot_use_mm_for_euclid_dist")[0]
    return (distance < radius[:, None] + radius).triu(1).nonzero(as_tuple=True)


def pairwise_bev_iou(a: Tensor, b: Tensor) -> Tensor:
    """(N,): IoU of the footprints of boxes a (N, 7) and b (N, 7), row by row."""
    shared = pairwise_bev_intersection(a, b)
    return shared / (a[:, 3] * a[:, 4] + b[:, 3] * b[:, 4] - shared)


def pairwise_bev_intersection(a: Tensor, b: Tensor) -> Tensor:
    """(N,) m2: area shared by the footprints of boxes a (N, 7) and b (N, 7), row by row.

    In the axes of b, the outline of a is cut where it crosses the lines along b's sides, and every point is moved to
    the nearest one of b. What lies inside stays, what lies outside collapses onto b's outline, where it adds no area
    of its own: the moved outline encloses the intersection. Nothing here jumps when boxes touch or coincide.
    """
    half = b[:, None, None, 3:5] / 2  # (N, 1, 1, 2)
    start = _corners_in_axes_of(a, b)  # (N, 4, 2)
    step = start.roll(-1, 1) - start
    limits = torch.cat([half, -half], -1)[:, 0]  # (N, 1, 4): +x, +y, -x, -y side
    cuts = ((limits - start.repeat(1, 1, 2)) / step.repeat(1, 1, 2)).nan_to_num(0).clamp(0, 1)  # (N, 4, 4)
    cuts = torch.cat([torch.zeros_like(cuts[..., :1]), cuts.sort(-1).values], -1)  # (N, 4, 5)
    outline = start[:, :, None] + cuts[..., None] * step[:, :, None]  # (N, 4, 5, 2)
    outline = torch.maximum(torch.minimum(outline, half), -half).flatten(1, 2)
    following = outline.roll(-1, 1)
    twice = (outline[..., 0] * following[..., 1] - outline[..., 1] * following[..., 0]).sum(1)
    return (twice / 2).clamp(min=0)


def _corners_in_axes_of(a: Tensor, b: Tensor) -> Tensor:
    """(N, 4, 2): footprint corners of a, counter-clockwise, from the centre and along the axes of b."""
    signs = a.new_tensor([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    centre = _turn(a[:, None, :2] - b[:, None, :2], -b[:, 6])
    return centre + _turn(signs * a[:, None, 3:5] / 2, a[:, 6] - b[:, 6])


def _turn(points: Tensor, angle: Tensor) -> Tensor:
    """Points (N, P, 2) turned counter-clockwise by angle (N,), radians."""
    cos, sin = angle.cos()[:, None], angle.sin()[:, None]
    x, y = points[..., 0], points[..., 1]
    return torch.stack([x * cos - y * sin, x * sin + y * cos], -1)
