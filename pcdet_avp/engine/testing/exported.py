"""An exported network in the place of the one in torch: for the benchmark of ``tools/test.py --runtime``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pcdet_avp.deploy.deployed import BothHalves, Deployed
from pcdet_avp.models.compression.bev_codec import Latent
from pcdet_avp.models.detectors.avp_cp import Link, received_as_sent
from pcdet_avp.models.export.opened import open_deployed
from pcdet_avp.structures.sensor_set import INFRA_SOURCES

READ = ("images", "trans_lidar_to_cam", "trans_cam_to_img", "source_present", "ego_from")  # without ``_infra``


def load_exported(cfg: Mapping, folder: Path, runtime: str) -> tuple[ExportedDetector, dict[str, Any]]:
    """(the detector, what the manifest says of its weights); ``cfg`` is the whole configuration."""
    deployed = open_deployed(folder, runtime, cfg)
    return ExportedDetector(deployed), dict(deployed.exported.facts) | {"runtime": deployed.name}


class ExportedDetector:
    """Called as ``AvpCp`` in evaluation: (batch_dict, link) -> (one dictionary of detections per sample, recall)."""

    training = False

    def __init__(self, deployed: Deployed) -> None:
        self._halves, network = BothHalves(deployed), deployed.exported.network
        self._shape = network.latent_shape
        codecs = {modality: SimpleNamespace(precision=one) for modality, one in network.latent_precision.items()}
        self.codec = SimpleNamespace(codecs=codecs, map_size=deployed.sent_size)  # what ``Wire`` asks for

    def eval(self) -> ExportedDetector:
        """As ``nn.Module``: it is always evaluated."""
        return self

    def train(self, mode: bool = True) -> ExportedDetector:
        """As ``nn.Module``, for those who put back what was before ``eval``."""
        return self

    def __call__(self, batch_dict: dict, link: Link = received_as_sent) -> tuple[list[dict[str, Tensor]], dict]:
        samples = [sample_of(batch_dict, b) for b in range(int(batch_dict["batch_size"]))]
        arrived = link(self._latents(samples))
        found = [self._halves.detect(sample, self._received(arrived, b)) for b, sample in enumerate(samples)]
        return [{key: torch.from_numpy(value) for key, value in one.items()} for one in found], {}

    def _latents(self, samples: list[dict]) -> dict[str, Latent]:
        """By source, for the whole batch: zero and absent where a sample lacks the source."""
        sent = [self._halves.latents(sample) for sample in samples]
        latents = {}
        for source in [s for s in INFRA_SOURCES if any(s in of_sample for of_sample in sent)]:
            values = np.stack([of_sample.get(source, np.zeros(self._shape, np.float32)) for of_sample in sent])
            present = torch.tensor([source in of_sample for of_sample in sent])[:, None, None, None]
            latents[source] = Latent(torch.from_numpy(values), present.expand(-1, 1, *self._shape[1:]))
        return latents

    @staticmethod
    def _received(latents: Mapping[str, Latent], b: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        rows = {source: (one.values[b].numpy(), one.received[b, 0].numpy()) for source, one in latents.items()}
        return {source: row for source, row in rows.items() if row[1].any()}


def sample_of(batch_dict: Mapping[str, Any], b: int) -> dict[str, np.ndarray]:
    """One frame of a batch as ``prepare`` made it, as far as the halves read it."""
    arrays = {key: value[b].cpu().numpy() for key, value in batch_dict.items() if _is_read(key, value)}
    for suffix in ("", "_infra"):
        arrays[f"images{suffix}"] = arrays[f"images{suffix}"].transpose(1, 2, 0)
        points = batch_dict[f"points{suffix}"]
        arrays[f"points{suffix}"] = points[points[:, 0] == b, 1:].cpu().numpy()
    return arrays


def _is_read(key: str, value: Any) -> bool:
    return isinstance(value, Tensor) and key.removesuffix("_infra") in READ
