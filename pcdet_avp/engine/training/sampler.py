"""Which samples, and which sensors, each iteration sees. A pure function of (seed, iteration): resuming is a number.

The sensor combination is drawn anew for every iteration (paper, section "Model Training & Benchmark") and is the
same for all samples of the batch and on all ranks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from torch.utils.data import Sampler

from pcdet_avp.errors import ConfigError
from pcdet_avp.structures.sensor_set import SENSOR_SETS, SensorSet

SHUFFLE, COMBINATION = 0, 1  # what a stream of random numbers is for


@dataclass(frozen=True)
class BatchPlan:
    """The samples of every global batch, without end."""

    samples: int  # in the data set
    batch_size: int  # over all ranks
    seed: int
    combos: Sequence[str] = tuple(SENSOR_SETS)

    def __post_init__(self) -> None:
        if self.samples < 1 or self.batch_size < 1:
            raise ConfigError(
                f"training needs at least one sample and one per batch, found {self.samples} samples "
                f"and a batch size of {self.batch_size}"
            )
        if not self.combos:
            raise ConfigError("OPTIMIZATION.SENSOR_SETS: expected at least one sensor combination, found none")
        for name in self.combos:
            SensorSet.parse(name)

    @property
    def per_epoch(self) -> int:
        """Iterations an epoch; samples that do not fill a batch wait for another epoch's shuffle."""
        return max(self.samples // self.batch_size, 1)

    def combo(self, iteration: int) -> str:
        """The sensor combination of an iteration."""
        rng = np.random.default_rng((self.seed, COMBINATION, iteration))
        return self.combos[rng.integers(len(self.combos))]

    def order(self, epoch: int) -> np.ndarray:
        """(samples,) the shuffle of an epoch, repeated where it is shorter than one batch."""
        shuffle = np.random.default_rng((self.seed, SHUFFLE, epoch)).permutation(self.samples)
        return np.resize(shuffle, max(self.samples, self.batch_size))

    def batch(self, iteration: int) -> np.ndarray:
        """(batch_size,) sample indices of the global batch."""
        epoch, place = divmod(iteration, self.per_epoch)
        return self.order(epoch)[place * self.batch_size : (place + 1) * self.batch_size]


class CombinationBatchSampler(Sampler):
    """One rank's batches of (index, combination, epoch) for ``AvpDataset.__getitem__``, from ``start`` on, endlessly.

    Rank r of W takes the r-th of W equal parts of the global batch, so the global batch does not depend on W.
    """

    def __init__(self, plan: BatchPlan, start: int = 0, rank: int = 0, world: int = 1) -> None:
        if plan.batch_size % world:
            raise ConfigError(f"batch size {plan.batch_size} does not divide among {world} processes")
        self.plan, self.start = plan, start
        part = plan.batch_size // world
        self.part = slice(rank * part, (rank + 1) * part)

    def __iter__(self) -> Iterator[list[tuple[int, str, int]]]:
        iteration = self.start
        while True:
            combo, epoch = self.plan.combo(iteration), iteration // self.plan.per_epoch
            yield [(int(index), combo, epoch) for index in self.plan.batch(iteration)[self.part]]
            iteration += 1
