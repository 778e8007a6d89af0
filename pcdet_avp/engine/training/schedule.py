"""The one-cycle schedule (OpenPCDet's ``adam_onecycle``): a pure function of the iteration.

    share of the training   0 ............ PCT_START ............ 1
    rate                    LR / DIV       LR                     LR / DIV / 10,000
    beta 1                  MOMS[0]        MOMS[1]                MOMS[0]

Both ways are half a cosine. A time budget may change the number of iterations on the way: what is left of the cycle
is then spread over what is left of the iterations, so that the rate does not jump.
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
    since: tuple[int, float] = (0, 0.0)  # iteration and share of the last change of ``total``

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
        """The schedule of OPTIMIZATION's LR, DIV_FACTOR, PCT_START and MOMS."""
        moms = require(optim_cfg, "MOMS", list)
        if len(moms) != 2:
            raise ConfigError(f"OPTIMIZATION.MOMS: expected two values, found {moms}")
        lr, div, pct = (float(require(optim_cfg, key, (int, float))) for key in ("LR", "DIV_FACTOR", "PCT_START"))
        return cls(total, lr, div, pct, (float(moms[0]), float(moms[1])))

    def share(self, iteration: int) -> float:
        """Share of the cycle that is done, from 0 to 1, when iteration ``iteration`` (from 0) begins."""
        start, share = self.since
        return min(share + (1 - share) * (iteration - start) / max(self.total - start, 1), 1.0)

    def at(self, iteration: int) -> tuple[float, float]:
        """(learning rate, first beta) of the step that iteration ``iteration`` takes."""
        start_lr, share = self.peak_lr / self.div_factor, self.share(iteration)
        if share < self.pct_start:
            up = share / self.pct_start
            return _cosine(start_lr, self.peak_lr, up), _cosine(*self.betas, up)
        down = (share - self.pct_start) / (1 - self.pct_start)
        return _cosine(self.peak_lr, start_lr / FINAL_DIV, down), _cosine(*self.betas[::-1], down)

    def ending_at(self, total: int, iteration: int) -> OneCycle:
        """The same cycle up to ``iteration``, stretched or compressed from there to end after ``total`` iterations."""
        return replace(self, total=total, since=(iteration, self.share(iteration)))


def _cosine(start: float, end: float, share: float) -> float:
    """The value between ``start`` and ``end`` along half a cosine; a plain float, for safe checkpoints."""
    return end + (start - end) / 2 * (1 + math.cos(math.pi * share))
