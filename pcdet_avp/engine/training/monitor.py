"""What a user sees of a training: the progress bar, the log, TensorBoard."""

from __future__ import annotations

import logging
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from pcdet_avp.engine.training.trainer import StepReport

BAR_SMOOTHING = 0.05  # sensor combinations differ in cost, so the rate is taken over many iterations


class Monitor:
    """Log and curves of a run, written by rank 0.

    Curves are means over ``interval`` iterations; a resumed run continues them at ``start``.
    """

    def __init__(self, folder: Path, logger: logging.Logger, start: int, total: int, interval: int) -> None:
        self.logger, self.interval = logger, interval
        self.writer = SummaryWriter(str(folder.absolute()), purge_step=start)
        slow = 0.1 if sys.stderr.isatty() else 10.0
        self.bar = tqdm(
            total=total, initial=start, unit="it", desc="training", smoothing=BAR_SMOOTHING, mininterval=slow
        )
        self._sums: dict[str, list[float]] = defaultdict(list)

    def set_total(self, total: int) -> None:
        """The schedule's length has been fixed."""
        self.bar.total = total
        self.bar.refresh()

    def add(self, report: StepReport) -> None:
        """Take note of an iteration."""
        self.bar.set_postfix_str(f"loss {report.loss:.3f}, {report.combo}", refresh=False)
        self.bar.update()
        self._collect(report)
        done = report.iteration + 1
        if done % self.interval == 0:
            self._flush(report, done)

    def picture(self, name: str, image: np.ndarray, iteration: int) -> None:
        """Show an (H, W, 3) uint8 image."""
        self.writer.add_image(name, image, iteration, dataformats="HWC")

    def numbers(self, numbers: dict[str, float], iteration: int) -> None:
        """Show numbers that belong to an iteration, such as a benchmark's."""
        for name, value in numbers.items():
            self.writer.add_scalar(name, value, iteration)

    def close(self) -> None:
        self.bar.close()
        self.writer.close()

    def _collect(self, report: StepReport) -> None:
        self._sums["train/loss"].append(report.loss)
        self._sums["meta_data/grad_norm"].append(report.grad_norm)
        self._sums[f"combination/{report.combo}"].append(report.loss)
        for name, value in report.terms.items():
            if name != "loss":
                self._sums[name if "/" in name else f"train/{name}"].append(value)

    def _flush(self, report: StepReport, done: int) -> None:
        means = {name: float(np.mean(values)) for name, values in self._sums.items()}
        self._sums.clear()
        self.numbers(means | {"meta_data/learning_rate": report.lr}, done)
        rate = self.bar.format_dict["rate"] or 0.0
        text = f"iteration {done}/{self.bar.total} loss {means['train/loss']:.4f} lr {report.lr:.3g} {rate:.2f} it/s"
        self.logger.info(text, extra={"quiet": True})


def write_scalars(folder: Path, numbers: dict[str, float], iteration: int) -> None:
    """Add numbers to TensorBoard outside of a training."""
    with SummaryWriter(str(folder)) as writer:
        for name, value in numbers.items():
            writer.add_scalar(name, value, iteration)
