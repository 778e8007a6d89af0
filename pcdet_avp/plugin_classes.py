"""Our data set and detector as OpenPCDet's own kinds of them: ``isinstance`` says so.

Importing this module imports OpenPCDet; ``pcdet_avp.plugin.register`` does it. The classes stand here, at the top of a
module, so that other processes find them by name. Nothing of the templates computes anything of ours.
"""

from __future__ import annotations

from typing import Any

from pcdet.datasets import DatasetTemplate
from pcdet.models.detectors import Detector3DTemplate
from torch import nn

from pcdet_avp.errors import PluginError
from pcdet_avp.openpcdet.dataset import OpenPCDetAvpDataset
from pcdet_avp.openpcdet.detector import OpenPCDetAvpCp


class RegisteredAvpDataset(OpenPCDetAvpDataset, DatasetTemplate):
    """``OpenPCDetAvpDataset`` that is a ``DatasetTemplate``."""

    def merge_all_iters_to_one_epoch(self, merge: bool = True, epochs: int | None = None) -> None:
        """The template's would be without effect here: PluginError."""
        raise PluginError("--merge_all_iters_to_one_epoch: AvpDataset has no such mode; leave the flag out")


class _TemplateWithoutParts(Detector3DTemplate):
    """OpenPCDet's template, which builds its parts from names of its own, before it has built any."""

    def __init__(self) -> None:
        nn.Module.__init__(self)


class RegisteredAvpCp(OpenPCDetAvpCp, _TemplateWithoutParts):
    """``OpenPCDetAvpCp`` that is a ``Detector3DTemplate``, with the attributes that its constructor sets."""

    def __init__(self, model_cfg: Any, num_class: int, dataset: Any) -> None:
        super().__init__(model_cfg=model_cfg, num_class=num_class, dataset=dataset)
        self.model_cfg, self.num_class = model_cfg, num_class
        self.dataset, self.class_names = dataset, dataset.class_names
