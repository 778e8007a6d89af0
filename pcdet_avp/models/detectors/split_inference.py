"""A network in two places: what runs at the mast ends in bytes, what runs in the vehicle begins with them."""

from __future__ import annotations

from collections.abc import Collection

import torch
from torch import nn

from pcdet_avp.link import LatentMap, MapStamp
from pcdet_avp.models.compression.map_packets import MapPacker, as_latent, precisions
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
        self._model = model.eval()
        self._packer = MapPacker(model.codec, max_segment_bytes, asked_by, budget_bytes)

    @torch.no_grad()
    def segments(self, batch_dict: dict, frame_id: int, time_us: int, world_from_infra: Pose) -> dict[str, list[bytes]]:
        """source -> segments of one frame's map; ``batch_dict`` as from ``load_batch``, its vehicle unused."""
        return {
            source: self._packer.pack(
                latent.values[0], MapStamp.at_pose(frame_id, time_us, modality_of(source), world_from_infra)
            )
            for source, latent in self._model.encode_roadside(batch_dict).items()
        }


class VehicleHalf:
    """Sensors and received maps to boxes: the vehicle's encoders and everything behind the link.

    The batch is one frame's, as from ``load_batch``, its roadside unused; maps may be any number of sources, captured
    at any time. Each is placed by its own pose and ``world_from_ego``, where the vehicle believes to be.
    """

    def __init__(self, model: nn.Module) -> None:
        self._model, self.shape = model.eval(), latent_shape(model)

    @torch.no_grad()
    def detect(self, batch_dict: dict, world_from_ego: Pose, maps: Collection[LatentMap]) -> dict[str, torch.Tensor]:
        """pred_boxes (n, 7), pred_scores (n,), pred_labels (n,) in the ego frame."""
        return self._model.post_processing(self.run(batch_dict, world_from_ego, maps))[0][0]

    @torch.no_grad()
    def run(self, batch_dict: dict, world_from_ego: Pose, maps: Collection[LatentMap]) -> dict:
        """The head's boxes and logits (see ``AnchorHeadSingle``) that ``detect`` filters."""
        received = self._received(batch_dict["ego_from_infra"], world_from_ego, maps)
        return self._model.fuse_and_detect({**self._model.encode_vehicle(batch_dict), **received})

    @staticmethod
    def _received(like: torch.Tensor, world_from_ego: Pose, maps: Collection[LatentMap]) -> dict:
        """``latents`` and ``ego_from_sender`` of the maps, by source, on the device of ``like``."""
        ego_from_world, by_source = world_from_ego.inverse(), {f"infra_{known.stamp.modality}": known for known in maps}
        poses, shared = {}, {}
        for source, known in by_source.items():
            matrix = (ego_from_world @ known.stamp.world_from_agent).matrix
            # A mast stands still: one tensor for all its maps lets the warp compute their geometry once.
            poses[source] = shared.setdefault(matrix.tobytes(), like.new_tensor(matrix)[None])
        latents = {source: as_latent(known, like.device) for source, known in by_source.items()}
        return {"latents": latents, "ego_from_sender": poses}
