"""The one-cycle schedule (OpenPCDet's ``adam_onecycle``): a pure function of the iteration, so nothing to resume.

    iteration   0 ............ PCT_START * total ............ total
    rate        LR / DIV       LR                             LR / DIV / 10,000
    beta 1      MOMS[0]        MOMS[1]                        MOMS[0]

Both ways are half a cosine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from pcdet_avp.config import require
from pcdet_avp.errors import ConfigError

FINAL_DIV = 1e4  # the rate ends this far below where it started


@dataclass(frozen=True)
class OneCycle:
    """Learning rate and first Adam beta over ``total`` iterations."""

    total: int
    peak_lr: float
    div_factor: float = 10.0
    pct_start: float = 0.4
    betas: tuple[float, float] = (0.95, 0.85)  # first beta at the ends, and at the peak

    def __post_init__(self) -> None:
        if self.total < 1:
            raise ConfigError(f"one-cycle schedule: expected at least 1 iteration, found {self.total}")
        if not (0 < self.pct_start < 1 and self.peak_lr > 0 and self.div_factor >= 1):
            raise ConfigError(
                "OPTIMIZATION: expected LR > 0, DIV_FACTOR >= 1 and 0 < PCT_START < 1, "
                f"found {self.peak_lr}, {self.div_factor}, {self.pct_start}"
            )

    @classmethod
    def from_config(cls, optim_cfg: dict, total: int) -> OneCycle:
        """From OPTIMIZATION's LR, DIV_FACTOR, PCT_START and MOMS."""
        moms = require(optim_cfg, "MOMS", list)
        if len(moms) != 2:
            raise ConfigError(f"OPTIMIZATION.MOMS: expected two values, found {moms}")
        lr, div, pct = (float(require(optim_cfg, key, (int, float))) for key in ("LR", "DIV_FACTOR", "PCT_START"))
        return cls(total, lr, div, pct, (float(moms[0]), float(moms[1])))

    def at(self, iteration: int) -> tuple[float, float]:
        """(learning rate, first beta) of the step that iteration ``iteration`` (from 0) takes."""
        start_lr, peak = self.peak_lr / self.div_factor, self.pct_start * self.total
        if iteration < peak:
            share = iteration / peak
            return _cosine(start_lr, self.peak_lr, share), _cosine(*self.betas, share)
        share = min((iteration - peak) / (self.total - peak), 1.0)
        return _cosine(self.peak_lr, start_lr / FINAL_DIV, share), _cosine(*self.betas[::-1], share)

    def with_total(self, total: int) -> OneCycle:
        """The same cycle stretched or squeezed to ``total`` iterations."""
        return replace(self, total=total)


def _cosine(start: float, end: float, share: float) -> float:
    """From ``start`` to ``end`` along half a cosine; plain floats, which ``torch.load(weights_only=True)`` accepts."""
    return end + (start - end) / 2 * (1 + math.cos(math.pi * share))
