"""Adam with decoupled weight decay over every parameter, driven by the one-cycle schedule.

``OPTIMIZATION.LR_FACTORS`` slows parts of the network down or freezes them: a mapping from the beginning of a
parameter's name (``encoders.ego_camera.image_backbone``) to its factor on the rate; the longest that fits counts.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import nn

from pcdet_avp.config import require
from pcdet_avp.errors import ConfigError

OPTIMIZERS = ("adam_onecycle",)
BETA_2 = 0.99


def build_optimizer(model: nn.Module, optim_cfg: dict) -> torch.optim.AdamW:
    """A group for every factor of ``LR_FACTORS``, with all parameters, bare ones, biases and norms too.

    A parameter with the factor 0 is frozen (``requires_grad`` off, so that no gradient is computed for it). One without
    a gradient (an encoder whose sensor the iteration lacks) is left as it is: no step, no decay.
    """
    name = require(optim_cfg, "OPTIMIZER", str)
    if name not in OPTIMIZERS:
        raise ConfigError(f"OPTIMIZATION.OPTIMIZER: unknown {name!r}; known: {', '.join(OPTIMIZERS)}")
    groups = _by_factor(model, optim_cfg.get("LR_FACTORS") or {})
    for parameter in groups.pop(0.0, ()):
        parameter.requires_grad_(False)
    beta_2 = float(optim_cfg.get("BETAS", (0.9, BETA_2))[1])
    decay = float(require(optim_cfg, "WEIGHT_DECAY", (int, float)))
    lr = float(require(optim_cfg, "LR", (int, float)))
    parts = [{"params": parameters, "factor": factor, "lr": factor * lr} for factor, parameters in groups.items()]
    if not parts:
        raise ConfigError("OPTIMIZATION.LR_FACTORS: nothing is left to train, expected a factor above 0 somewhere")
    return torch.optim.AdamW(parts, lr=lr, betas=(0.9, beta_2), weight_decay=decay, fused=True)


def _by_factor(model: nn.Module, factors: Mapping[str, float]) -> dict[float, list[nn.Parameter]]:
    """The parameters that want gradients, by their part of the rate: that of the longest prefix of their name, or 1."""
    named = [(name, parameter) for name, parameter in model.named_parameters() if parameter.requires_grad]
    for prefix in factors:
        if not any(_within(name, prefix) for name, _ in named):
            known = sorted({".".join(name.split(".")[:2]) for name, _ in named})
            raise ConfigError(
                f"OPTIMIZATION.LR_FACTORS: no parameter is within {prefix!r}; there are {', '.join(known)}"
            )
    groups: dict[float, list[nn.Parameter]] = {}
    for name, parameter in named:
        prefix = max((prefix for prefix in factors if _within(name, prefix)), key=len, default=None)
        groups.setdefault(1.0 if prefix is None else float(factors[prefix]), []).append(parameter)
    return groups


def _within(name: str, prefix: str) -> bool:
    return name == prefix or name.startswith(f"{prefix}.")


def set_point(optimizer: torch.optim.Optimizer, lr: float, beta_1: float) -> None:
    """Put a point of the schedule into the optimiser."""
    for group in optimizer.param_groups:
        group["lr"] = lr * group["factor"]
        group["betas"] = (beta_1, group["betas"][1])


def load_moments(optimizer: torch.optim.Optimizer, state: dict) -> None:
    """Take up the moments of a checkpoint. The factors stay this run's: a checkpoint of old has none."""
    factors = [group["factor"] for group in optimizer.param_groups]
    optimizer.load_state_dict(state)
    for group, factor in zip(optimizer.param_groups, factors, strict=True):
        group["factor"] = factor
