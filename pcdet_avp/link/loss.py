"""Loss of transport blocks: independent, or in bursts (Gilbert 1960, Elliott 1963)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcdet_avp.errors import LinkError


@dataclass(frozen=True)
class LossModel:
    """A channel that is good or bad in each slot, and loses a block with a probability of its state.

    Probabilities per slot of going from good to bad and back, and of losing a block in either state.
    """

    good_to_bad: float
    bad_to_good: float
    loss_in_good: float
    loss_in_bad: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0 <= value <= 1:
                raise LinkError(f"loss model: {name} must be a probability, found {value}")

    @classmethod
    def independent(cls, probability: float) -> LossModel:
        """Every block for itself."""
        return cls(0.0, 1.0, probability, probability)

    @classmethod
    def bursty(cls, probability: float, mean_burst_slots: float) -> LossModel:
        """Lose this share of the blocks on average, all those in bursts of this mean length and no others."""
        if not 0 <= probability < 1 or not mean_burst_slots >= 1:
            found = f"{probability} and {mean_burst_slots}"
            raise LinkError(f"bursty loss: expected a share below 1 and bursts of at least one slot, found {found}")
        return cls(probability / (1 - probability) / mean_burst_slots, 1 / mean_burst_slots, 0.0, 1.0)

    @property
    def share_bad(self) -> float:
        """Share of the slots in which the channel is bad."""
        leaving = self.good_to_bad + self.bad_to_good
        return self.good_to_bad / leaving if leaving > 0 else 0.0

    @property
    def mean_loss(self) -> float:
        """Share of the blocks that are lost."""
        return self.share_bad * self.loss_in_bad + (1 - self.share_bad) * self.loss_in_good


class LossProcess:
    """The channel's state over time; idle slots pass too."""

    def __init__(self, model: LossModel, generator: np.random.Generator) -> None:
        self._model, self._generator = model, generator
        self._bad, self._slot = generator.random() < model.share_bad, 0

    def loses(self, slot: int) -> bool:
        """Whether a block sent in this slot is lost; slots must not decrease."""
        if slot > self._slot:
            self._bad = self._generator.random() < self._chance_of_bad(slot - self._slot)
            self._slot = slot
        loss = self._model.loss_in_bad if self._bad else self._model.loss_in_good
        return bool(self._generator.random() < loss)

    def _chance_of_bad(self, slots: int) -> float:
        """Chance of a bad state some slots after the present one (the two-state chain in closed form)."""
        model = self._model
        memory = (1 - model.good_to_bad - model.bad_to_good) ** slots
        return model.share_bad + (self._bad - model.share_bad) * memory
