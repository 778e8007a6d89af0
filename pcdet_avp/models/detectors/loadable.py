"""What OpenPCDet's training loop asks of a detector besides its forward pass: a step counter, weights from files."""

from __future__ import annotations

import logging
import os
from typing import Any

import torch
from torch import nn

from pcdet_avp.models.weights.checkpoint_file import read_checkpoint
from pcdet_avp.models.weights.load import load_weights


class LoadableDetector(nn.Module):
    """A network that counts its training steps and takes its weights from checkpoints."""

    def add_global_step(self) -> None:
        """The buffer ``global_step``, to be added last."""
        self.register_buffer("global_step", torch.zeros(1, dtype=torch.int64))

    def update_global_step(self) -> None:
        """Count a training step, as OpenPCDet's training loop does."""
        self.global_step += 1

    def load_params_from_file(
        self, filename: str | os.PathLike, logger: logging.Logger, to_cpu: bool = False, pre_trained_path: Any = None
    ) -> None:
        """Load weights; first those of ``pre_trained_path``, if given. See ``load_weights`` for what is refused."""
        for path in filter(None, (pre_trained_path, filename)):
            load_weights(self, self._read(path, to_cpu), path, logger)

    def load_params_with_optimizer(
        self,
        filename: str | os.PathLike,
        to_cpu: bool = False,
        optimizer: torch.optim.Optimizer | None = None,
        logger: logging.Logger | None = None,
    ) -> tuple[int, int]:
        """Load weights and the optimiser's state; the iteration and epoch they were saved at."""
        logger = logger or logging.getLogger(__name__)
        content = self._read(filename, to_cpu)
        load_weights(self, content, filename, logger)
        if optimizer is not None and content.get("optimizer_state") is not None:
            optimizer.load_state_dict(content["optimizer_state"])
        return int(content.get("it", 0)), int(content.get("epoch", -1))

    def _read(self, path: str | os.PathLike, to_cpu: bool) -> dict:
        return read_checkpoint(path, "cpu" if to_cpu else self.global_step.device)
