"""The stage before the warp that corrects where received maps are placed (see ``pcdet_avp.registration``).

It compares the LiDAR maps of both sides; where one of them is missing nothing is corrected. Off by default, and then
the very batch that came in goes on.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pcdet_avp.registration import Correction, Registrar, RegistrationSettings
from pcdet_avp.registration.registrar import NONE, OWN, SENT, Received
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.pose import Pose


class RegisterMaps:
    """Corrects the poses of all received maps of a sample by one motion, that of the vehicle's error."""

    def __init__(self, grid: BevGrid, settings: RegistrationSettings, codec: Any = None) -> None:
        """``codec``: whose ``decompress`` makes maps of what arrived (``BevCodec``); None: these are maps already."""
        self.settings, self._registrar, self._codec = settings, Registrar(grid, settings), codec

    def __call__(self, batch_dict: dict) -> dict:
        """
        Args: batch_dict:
            bev_maps[ego_lidar] (B, C, H, W), bev_valid[ego_lidar] (B, 1, H, W) bool, source_present (B, 4)
            latents[infra_lidar], ego_from_infra (B, 4, 4); ego_from_sender, map_samples: as in ``WarpToEgo``
            correction_memory: a ``SteadyCorrection``, optional, for batches of one: the vehicle's, over time
        Returns: batch_dict with
            ego_from_infra and ego_from_sender corrected, corrections [Correction] of each sample as measured
        """
        if not self.settings.enabled:
            return batch_dict
        maps = self._maps(batch_dict)
        corrections = [self._correction(batch_dict, maps, i) for i in range(int(batch_dict["batch_size"]))]
        memory = batch_dict.get("correction_memory")
        poses = [c.true_from_believed if memory is None else memory(c) for c in corrections]
        batch_dict = {**batch_dict, "corrections": corrections}
        if all(np.array_equal(pose.matrix, np.eye(4)) for pose in poses):
            return batch_dict
        return batch_dict | _moved(batch_dict, torch.from_numpy(np.stack([pose.matrix for pose in poses])))

    def _correction(self, batch_dict: dict, maps: Tensor | None, sample: int) -> Correction:
        bev_map = batch_dict["bev_maps"].get(OWN)
        if bev_map is None or maps is None:
            return NONE
        own = {OWN: (_array(bev_map[sample]), _array(batch_dict["bev_valid"][OWN][sample, 0]))}
        return self._registrar(own, list(_received(batch_dict, maps, sample)))

    def _maps(self, batch_dict: dict) -> Tensor | None:
        """(n, C, h, w), what was received: of the cells that were pooled into one, one is enough."""
        latent = batch_dict["latents"].get(SENT)
        if latent is None:
            return None
        if self._codec is None:
            return torch.where(latent.received, latent.values, 0)
        alone = {"latents": {SENT: latent}, "bev_maps": {}, "bev_valid": {}}
        maps = self._codec.decompress({**batch_dict, **alone})["bev_maps"][SENT]
        pooling = maps.shape[2] // latent.values.shape[2]
        return maps[..., ::pooling, ::pooling]


def _received(batch_dict: dict, maps: Tensor, sample: int) -> Iterator[Received]:
    """The maps of a sample's units."""
    poses = batch_dict.get("ego_from_sender", {}).get(SENT, batch_dict["ego_from_infra"])
    for row, of_sample in enumerate(_samples(batch_dict, SENT, len(maps))):
        if of_sample == sample:
            yield Received(_array(maps[row]), Pose(_array(poses[row]).astype(np.float64)))


def _samples(batch_dict: dict, source: str, maps: int) -> list[int]:
    """The sample of each map."""
    samples = batch_dict.get("map_samples", {}).get(source)
    return list(range(maps)) if samples is None else samples.tolist()


def _moved(batch_dict: dict, motions: Tensor) -> dict:
    """The poses behind the motions (B, 4, 4), float64; maps that shared a tensor still do."""
    done: dict[int, Tensor] = {}

    def moved(pose: Tensor, samples: list[int]) -> Tensor:
        if id(pose) not in done:
            of_maps = motions[samples].to(pose.device)
            done[id(pose)] = (of_maps @ pose.double()).to(pose.dtype)
        return done[id(pose)]

    poses = batch_dict.get("ego_from_sender", {})
    infra = moved(batch_dict["ego_from_infra"], list(range(len(motions))))
    senders = {source: moved(pose, _samples(batch_dict, source, len(pose))) for source, pose in poses.items()}
    return {"ego_from_infra": infra} | ({"ego_from_sender": senders} if poses else {})


def _array(tensor: Tensor) -> np.ndarray:
    tensor = tensor.detach().cpu()
    return (tensor.float() if tensor.is_floating_point() else tensor).numpy()
