"""Trading time for memory in training: activations of a module are computed again when its gradients are due."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

from torch import nn
from torch.nn.modules.batchnorm import _BatchNorm
from torch.utils.checkpoint import checkpoint


def recomputed(module: nn.Module, *inputs: Any) -> Any:
    """``module(*inputs)``, of which only inputs and outputs are kept; the backward pass runs it a second time.

    Outputs and gradients are the same bits on a CPU; random draws are repeated. Batch norms see each batch twice,
    but count it into their running statistics once.
    """
    return checkpoint(
        module, *inputs, use_reentrant=False, context_fn=lambda: (nullcontext(), running_statistics_kept(module))
    )


@contextmanager
def running_statistics_kept(module: nn.Module) -> Iterator[None]:
    """While active, batch norms in training mode normalise as ever and leave their running statistics as they are."""
    norms = [m for m in module.modules() if isinstance(m, _BatchNorm) and m.training and m.track_running_stats]
    before = [(norm.momentum, norm.num_batches_tracked.clone()) for norm in norms]
    for norm in norms:
        norm.momentum = 0.0
    try:
        yield
    finally:
        for norm, (momentum, batches) in zip(norms, before, strict=True):
            norm.momentum = momentum
            norm.num_batches_tracked.copy_(batches)
