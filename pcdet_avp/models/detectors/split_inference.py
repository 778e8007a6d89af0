"""A network in two places: what runs in a roadside unit ends in bytes, what runs in the vehicle begins with them."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import torch
from torch import nn

from pcdet_avp.link import LatentMap, MapStamp
from pcdet_avp.link.units import by_source
from pcdet_avp.models.compression.map_packets import MapPacker, as_latents, precisions
from pcdet_avp.registration import SteadyCorrection
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import modality_of


def latent_shape(model: nn.Module) -> tuple[int, int, int]:
    """(c, h, w) of a map on the air."""
    precisions(model.codec, "a network in two places")
    codec, grid = next(iter(model.codec.codecs.values())), model.warp.grid
    return codec.latent_shape(grid.height, grid.width)


class RoadsideHalf:
    """Sensors to segments: the roadside's encoders and the compressor."""

    def __init__(
        self, model: nn.Module, max_segment_bytes: int, budget_bytes: int | None = None, asked_by: str = "roadside"
    ) -> None:
        """``budget_bytes`` and ``asked_by`` as in ``MapPacker``."""
        self.network_number = 0  # what its maps say of the network that made them; 0: nothing
        self._model = model.eval()
        self._packer = MapPacker(model.codec, max_segment_bytes, asked_by, budget_bytes)

    @torch.no_grad()
    def segments(
        self, batch_dict: dict, frame_id: int, time_us: int, world_from_infra: Pose, sender: int = 0
    ) -> dict[str, list[bytes]]:
        """source -> segments of one frame's map; ``batch_dict`` as from ``load_batch``, its vehicle unused.

        ``sender`` is the unit's number at its site.
        """
        latents, stamped = self._model.encode_roadside(batch_dict), {}
        for source, latent in latents.items():
            origin = sender, self.network_number
            stamp = MapStamp.at_pose(frame_id, time_us, modality_of(source), world_from_infra, *origin)
            with self._model.stages("pack"):
                stamped[source] = self._packer.pack(latent.values[0], stamp)
        return stamped


class VehicleHalf:
    """Sensors and received maps to boxes: the vehicle's encoders and everything behind the link.

    The batch is one frame's, as from ``load_batch``, its roadside unused; maps may be of any sources of any number of
    roadside units, captured at any time, in any order. Each is placed by its own pose and ``world_from_ego``, where the
    vehicle believes to be. Two of one unit and modality are an error.
    """

    def __init__(self, model: nn.Module, follows_time: bool = False) -> None:
        """``follows_time``: frames come from one vehicle, one after the other, so that corrections by registration (off
        by default, see MODEL.REGISTRATION) are smoothed over them."""
        self._model, self.shape = model.eval(), latent_shape(model)
        settings = model.registration.settings
        smoothed = follows_time and settings.enabled
        self._memory = {"correction_memory": SteadyCorrection(settings.frames)} if smoothed else {}

    @torch.no_grad()
    def detect(self, batch_dict: dict, world_from_ego: Pose, maps: Collection[LatentMap]) -> dict[str, torch.Tensor]:
        """pred_boxes (n, 7), pred_scores (n,), pred_labels (n,) in the ego frame."""
        return self._model.detect(self._with_maps(batch_dict, world_from_ego, maps))[0]

    @torch.no_grad()
    def run(self, batch_dict: dict, world_from_ego: Pose, maps: Collection[LatentMap]) -> dict:
        """The head's boxes and logits (see ``AnchorHeadSingle``), of which ``detect`` keeps few."""
        return self._model.fuse_and_detect(self._with_maps(batch_dict, world_from_ego, maps))

    def _with_maps(self, batch_dict: dict, world_from_ego: Pose, maps: Collection[LatentMap]) -> dict:
        """The vehicle's own maps and those it received."""
        received = self._received(batch_dict["ego_from_infra"], world_from_ego, maps)
        return self._model.encode_vehicle({**batch_dict, **received, **self._memory})

    @staticmethod
    def _received(like: torch.Tensor, world_from_ego: Pose, maps: Collection[LatentMap]) -> dict:
        """``latents``, ``ego_from_sender`` and ``map_samples`` of the maps, by source, on the device of ``like``."""
        ego_from_world, latents, poses, shared = world_from_ego.inverse(), {}, {}, {}
        for source, of_units in by_source(maps).items():
            matrices = np.stack([(ego_from_world @ known.stamp.world_from_agent).matrix for known in of_units])
            # A mast stands still: one tensor for all its maps lets the warp compute their geometry once.
            poses[source] = shared.setdefault(matrices.tobytes(), like.new_tensor(matrices))
            latents[source] = as_latents(of_units, like.device)
        samples = {
            source: torch.zeros(len(pose), dtype=torch.int64, device=like.device) for source, pose in poses.items()
        }
        return {"latents": latents, "ego_from_sender": poses, "map_samples": samples}
