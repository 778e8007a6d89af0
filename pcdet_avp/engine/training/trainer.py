"""One training step after the other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import nn

from pcdet_avp.config import require
from pcdet_avp.engine.distributed import Ranks
from pcdet_avp.engine.seed import seed_torch
from pcdet_avp.engine.training.optimizer import build_optimizer, set_point
from pcdet_avp.engine.training.sampler import BatchPlan
from pcdet_avp.engine.training.schedule import OneCycle
from pcdet_avp.errors import ConfigError, TrainingError

AMP_DTYPES = {"bf16": torch.bfloat16, "fp16": torch.float16}
TRAINING_STREAM = 1  # torch's random numbers during training; weights are drawn from the plain seed


@dataclass(frozen=True)
class StepReport:
    """What one iteration did."""

    iteration: int  # counted from 0
    combo: str
    loss: float
    terms: Mapping[str, float]  # the network's own tb_dict
    lr: float
    grad_norm: float


class Trainer:
    """A network, its optimiser and schedule, and the number of iterations done.

    The network follows OpenPCDet: in training ``model(batch_dict)`` is ({"loss": scalar}, tb_dict, disp_dict).
    """

    def __init__(
        self, model: nn.Module, optim_cfg: dict, plan: BatchPlan, planned: int, ranks: Ranks, use_amp: bool = False
    ) -> None:
        """``planned`` is the schedule's length in iterations, unless a time budget shortens it later."""
        self.model = model.to(ranks.device)
        self.parallel = ranks.wrap(self.model)
        self.plan, self.ranks, self.planned = plan, ranks, planned
        self.schedule = OneCycle.from_config(optim_cfg, planned)
        self.optimizer = build_optimizer(self.model, optim_cfg)
        self.clip = float(require(optim_cfg, "GRAD_NORM_CLIP", (int, float)))
        self.amp_dtype = _amp_dtype(optim_cfg) if use_amp else None
        self.scaler = torch.amp.GradScaler(ranks.device.type, enabled=self.amp_dtype is torch.float16)
        self.iteration = 0
        self.elapsed_s = 0.0  # spent on training, earlier runs included
        self.parallel.train()
        seed_torch(plan.seed, TRAINING_STREAM, ranks.rank)

    @property
    def precision(self) -> str:
        """What it computes in: float32, bfloat16 or float16."""
        return str(self.amp_dtype or torch.float32).removeprefix("torch.")

    @property
    def epoch(self) -> int:
        """Completed passes over the training split."""
        return self.iteration // self.plan.per_epoch

    @property
    def finished(self) -> bool:
        return self.iteration >= self.schedule.total

    def step(self, batch_dict: dict) -> StepReport:
        """Learn from one batch (tensors on the device); raises TrainingError, before any change, on a NaN."""
        combo = self.plan.combo(self.iteration)
        lr, beta_1 = self.schedule.at(self.iteration)
        set_point(self.optimizer, lr, beta_1)
        if not self.parallel.training:
            self.parallel.train()
        self.optimizer.zero_grad(set_to_none=True)
        with torch.autocast(self.ranks.device.type, self.amp_dtype, enabled=self.amp_dtype is not None):
            returned, terms, _ = self.parallel(batch_dict)
            loss = returned["loss"].mean()
        value = float(loss.detach())
        self._refuse(self.ranks.any([not math.isfinite(value)])[0], f"the loss is {value}", combo)
        self.scaler.scale(loss).backward()
        norm = self._clip_gradients(combo)
        self.scaler.step(self.optimizer)
        self.scaler.update()
        if hasattr(self.model, "update_global_step"):
            self.model.update_global_step()
        self.iteration += 1
        numbers = {key: float(value) for key, value in terms.items()}
        return StepReport(self.iteration - 1, combo, value, numbers, lr, norm)

    def _clip_gradients(self, combo: str) -> float:
        """Scale the gradients down to norm ``clip``; the norm before. A scaler skips steps that overflow by itself."""
        self.scaler.unscale_(self.optimizer)
        norm = float(nn.utils.clip_grad_norm_(self.model.parameters(), self.clip))
        bad = not math.isfinite(norm) and not self.scaler.is_enabled()
        self._refuse(bad, f"the gradient's norm is {norm}", combo)
        return norm

    def _refuse(self, bad: bool, what: str, combo: str) -> None:
        if bad:
            raise TrainingError(
                f"iteration {self.iteration}, sensors {combo}: {what}; nothing was saved. A smaller OPTIMIZATION.LR "
                "may help; the same command goes on from the last checkpoint"
            )


def _amp_dtype(optim_cfg: dict) -> torch.dtype:
    name = optim_cfg.get("AMP_DTYPE", "bf16")
    if name not in AMP_DTYPES:
        raise ConfigError(f"OPTIMIZATION.AMP_DTYPE: unknown {name!r}; known: {', '.join(AMP_DTYPES)}")
    return AMP_DTYPES[name]
