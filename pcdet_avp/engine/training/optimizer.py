"""Adam with decoupled weight decay over every parameter, driven by the one-cycle schedule."""

from __future__ import annotations

import torch
from torch import nn

from pcdet_avp.config import require
from pcdet_avp.errors import ConfigError

OPTIMIZERS = ("adam_onecycle",)
BETA_2 = 0.99


def build_optimizer(model: nn.Module, optim_cfg: dict) -> torch.optim.AdamW:
    """One group with all parameters that want gradients, those outside leaf modules, biases and norms included.

    A parameter without a gradient (an encoder whose sensor the iteration lacks) is left as it is: no step, no decay.
    """
    name = require(optim_cfg, "OPTIMIZER", str)
    if name not in OPTIMIZERS:
        raise ConfigError(f"OPTIMIZATION.OPTIMIZER: unknown {name!r}; known: {', '.join(OPTIMIZERS)}")
    parameters = [p for p in model.parameters() if p.requires_grad]
    beta_2 = float(optim_cfg.get("BETAS", (0.9, BETA_2))[1])
    decay = float(require(optim_cfg, "WEIGHT_DECAY", (int, float)))
    lr = float(require(optim_cfg, "LR", (int, float)))
    return torch.optim.AdamW(parameters, lr=lr, betas=(0.9, beta_2), weight_decay=decay, fused=True)


def set_point(optimizer: torch.optim.Optimizer, lr: float, beta_1: float) -> None:
    """Put a point of the schedule into the optimiser."""
    for group in optimizer.param_groups:
        group["lr"] = lr
        group["betas"] = (beta_1, group["betas"][1])
