"""The head's losses, summed over anchors; and normalisers that mean the same on one process and on many."""

from __future__ import annotations

import torch
import torch.distributed as dist
import torch.nn.functional as F
from torch import Tensor


def sigmoid_focal_loss(logits: Tensor, targets: Tensor, alpha: float = 0.25, gamma: float = 2.0) -> Tensor:
    """-alpha_t (1 - p_t)^gamma log p_t (Lin et al., ICCV 2017, equation 5); all shapes (...,), targets 0 or 1."""
    cross_entropy = F.binary_cross_entropy_with_logits(logits, targets, reduction="none")
    missed = 1 - torch.exp(-cross_entropy)  # 1 - p_t
    alpha_t = torch.where(targets > 0, alpha, 1 - alpha)
    return alpha_t * missed**gamma * cross_entropy


def box_loss(codes: Tensor, targets: Tensor, code_weights: Tensor, beta: float = 1 / 9) -> Tensor:
    """Smooth L1 per code, (N, 7) each; the heading enters as the sine of its error, which ignores half turns.

    (SECOND, section 3.3.1.) The remaining half turn is the direction classifier's.
    """
    error = codes - targets
    error = torch.cat([error[:, :6], torch.sin(error[:, 6:7])], 1) * code_weights
    return F.smooth_l1_loss(error, torch.zeros_like(error), beta=beta, reduction="none")


def shared_normaliser(counts: Tensor) -> Tensor:
    """Divide a rank's sums by this, and the mean over ranks is what one process with the whole batch would compute.

    counts (...,): this rank's. max(sum over ranks, 1) / number of ranks, since data-parallel training averages.
    """
    counts = counts.float()
    if not (dist.is_available() and dist.is_initialized()):
        return counts.clamp(min=1)
    counts = counts.clone()
    dist.all_reduce(counts)
    return counts.clamp(min=1) / dist.get_world_size()
