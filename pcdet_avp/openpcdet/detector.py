"""Our network under OpenPCDet's training loop."""

from __future__ import annotations

import torch.distributed as dist

from pcdet_avp.models.detectors.avp_cp import AvpCp
from pcdet_avp.openpcdet.dataset import EGO_IMAGES


class HostAvpCp(AvpCp):
    """``AvpCp`` that finds the ego's images where ``HostAvpDataset`` puts them.

    Under several processes the host averages gradients and expects one from every parameter, but an absent sensor's
    encoder has none: there, every parameter takes part in the loss with weight zero.
    """

    def forward(self, batch_dict: dict) -> tuple:
        if EGO_IMAGES in batch_dict:
            batch_dict = {**batch_dict, "images": batch_dict[EGO_IMAGES]}
        result = super().forward(batch_dict)
        if self.training and dist.is_available() and dist.is_initialized():
            result[0]["loss"] = result[0]["loss"] + 0.0 * sum(p.sum() for p in self.parameters() if p.requires_grad)
        return result
