"""The training loop: step, look, save, stop when asked."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcdet_avp.engine import checkpoint
from pcdet_avp.engine.training.interrupt import Interrupt
from pcdet_avp.engine.training.monitor import Monitor
from pcdet_avp.engine.training.run_state import run_state
from pcdet_avp.engine.training.time_budget import TimeBudget
from pcdet_avp.engine.training.trainer import StepReport, Trainer


@dataclass
class CheckpointSaver:
    """Writes checkpoints: one at the end of every ``epoch_interval`` epochs, and the newest state every so often."""

    folder: Path
    about: dict[str, Any]  # what every checkpoint says besides the run's state
    epoch_interval: int = 1
    keep: int = 30
    time_interval_s: float = 300.0
    saved_at: float = 0.0

    def __post_init__(self) -> None:
        self.saved_at = time.monotonic()

    def is_due(self) -> bool:
        """Whether the newest state has not been written for long."""
        return time.monotonic() - self.saved_at >= self.time_interval_s

    def closes_epoch(self, trainer: Trainer) -> bool:
        """Whether the iteration just done ends an epoch that is to be kept, or the training."""
        ended = trainer.iteration % trainer.plan.per_epoch == 0 and trainer.epoch % self.epoch_interval == 0
        return ended or trainer.finished

    def save(self, trainer: Trainer, name: str) -> Path:
        """Write a checkpoint (rank 0; the others lend their random states)."""
        path, content = self.folder / name, run_state(trainer) | self.about
        if trainer.ranks.is_first:
            checkpoint.save(path, content)
            checkpoint.drop_oldest(self.folder, self.keep, path)
        self.saved_at = time.monotonic()
        return path


def epoch_file(trainer: Trainer) -> str:
    """The name of the checkpoint of the epoch just ended, or broken off by the end of the schedule."""
    return f"checkpoint_epoch_{-(-trainer.iteration // trainer.plan.per_epoch)}.pth"


def train(
    trainer: Trainer,
    batches: Iterable[dict],
    saver: CheckpointSaver,
    logger: logging.Logger,
    monitor: Monitor | None = None,
    budget: TimeBudget | None = None,
    on_step: Callable[[int], None] | None = None,
) -> None:
    """Train until the schedule ends; Ctrl-C saves first. Rank 0 calls ``on_step(iteration)`` after every step."""
    with Interrupt(speaks=trainer.ranks.is_first) as interrupt:
        for report, seconds in _steps(trainer, batches, interrupt):
            if monitor:
                monitor.add(report)
            if on_step and trainer.ranks.is_first:
                on_step(trainer.iteration)
            if budget:
                budget.add(report.combo, seconds)
            _between_steps(trainer, saver, logger, monitor, budget, interrupt)


def _steps(trainer: Trainer, batches: Iterable[dict], interrupt: Interrupt) -> Iterator[tuple[StepReport, float]]:
    """Steps up to the schedule's end, each with the seconds since the one before, whatever was done between them."""
    before = time.monotonic()
    source = iter(batches)
    while not trainer.finished:
        try:
            report = trainer.step(next(source))
        except RuntimeError:
            if interrupt.requested:  # it has ended the workers that load data, too; this step is lost
                raise KeyboardInterrupt from None
            raise
        now = time.monotonic()
        trainer.elapsed_s += now - before
        yield report, now - before
        before = now


def _between_steps(trainer, saver, logger, monitor, budget, interrupt) -> None:
    """Whatever one rank wants, all do in the same iteration."""
    first = trainer.ranks.is_first
    wants_plan = bool(budget) and first and not trainer.finished and budget.wants_plan(trainer.elapsed_s)
    stop, due, replan = trainer.ranks.any([interrupt.requested, first and saver.is_due(), wants_plan])
    if replan:
        _plan(trainer, logger, monitor, budget)
    if saver.closes_epoch(trainer):
        saver.save(trainer, epoch_file(trainer))
    elif due or stop:
        path = saver.save(trainer, checkpoint.LATEST)
        logger.info(f"iteration {trainer.iteration}: saved {path.name}", extra={"quiet": not stop})
    if stop and not trainer.finished:
        raise KeyboardInterrupt


def _plan(trainer: Trainer, logger: logging.Logger, monitor: Monitor | None, budget: TimeBudget) -> None:
    """Change the schedule so that it ends with the time budget. Rank 0 decides. A resumed run keeps this schedule."""
    again = budget.has_plan
    total = budget.plan(trainer.iteration, trainer.elapsed_s, trainer.planned) if trainer.ranks.is_first else None
    total = trainer.ranks.from_first(total)
    trainer.schedule = trainer.schedule.ending_at(total, trainer.iteration)
    if trainer.ranks.is_first:
        logger.info(
            f"{budget.seconds_per_iteration:.3f} s per iteration: {total} iterations "
            f"({total / trainer.plan.per_epoch:.1f} epochs) fit into {budget.budget_s / 60:.1f} minutes; "
            f"the configuration asks for {trainer.planned}",
            extra={"quiet": again},
        )
    if monitor:
        monitor.set_total(total)
