"""Our network under OpenPCDet's training loop."""

from __future__ import annotations

import logging

import torch.distributed as dist
from torch import Tensor

from pcdet_avp.models.detectors.avp_cp import AvpCp
from pcdet_avp.models.weights.agreement import MEANING_KEY, as_tensor, check_meaning, from_tensor
from pcdet_avp.openpcdet.dataset import EGO_IMAGES


class OpenPCDetAvpCp(AvpCp):
    """``AvpCp`` that finds the ego's images where ``OpenPCDetAvpDataset`` puts them.

    Under several processes OpenPCDet averages gradients and expects one from every parameter, but an absent sensor's
    encoder has none: there, every parameter takes part in the loss with weight zero. Checkpoints that OpenPCDet
    writes hold nothing but tensors: what the weights mean travels among them.
    """

    def forward(self, batch_dict: dict) -> tuple:
        if EGO_IMAGES in batch_dict:
            batch_dict = {**batch_dict, "images": batch_dict[EGO_IMAGES]}
        result = super().forward(batch_dict)
        if self.training and dist.is_available() and dist.is_initialized():
            result[0]["loss"] = result[0]["loss"] + 0.0 * sum(p.sum() for p in self.parameters() if p.requires_grad)
        return result

    def get_extra_state(self) -> Tensor:
        """What the weights mean, see ``as_tensor``."""
        return as_tensor(self.meaning.values)

    def set_extra_state(self, state: Tensor) -> None:
        """Raises CheckpointError where the weights that are being loaded mean something else."""
        content = {MEANING_KEY: from_tensor(state), "model_state": dict(self.named_parameters())}
        check_meaning(self, content, "model_state", logging.getLogger(__name__))
