"""A network in two places: what runs at the mast ends in bytes, what runs in the vehicle begins with them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import nn

from pcdet_avp.errors import ConfigError
from pcdet_avp.link import LatentMap, MapStamp, encode_within
from pcdet_avp.models.compression.map_packets import as_latent
from pcdet_avp.structures.pose import Pose


def latent_shape(model: nn.Module) -> tuple[int, int, int]:
    """(c, h, w) of a map on the air."""
    codec, grid = next(iter(model.codec.codecs.values())), model.warp.grid
    if not hasattr(codec, "latent_shape"):
        raise ConfigError("MODEL.COMPRESSION sends maps as they are; there are no bytes for them")
    return codec.latent_shape(grid.height, grid.width)


class RoadsideHalf:
    """Sensors to segments: the roadside's encoders and the compressor."""

    def __init__(self, model: nn.Module, max_segment_bytes: int, budget_bytes: int) -> None:
        """``budget_bytes``: what a map may take, everything counted."""
        self.model, self.shape = model.eval(), latent_shape(model)
        self.max_segment_bytes, self.budget_bytes = max_segment_bytes, budget_bytes

    def segments(self, batch_dict: dict, frame_id: int, time_us: int, world_from_infra: Pose) -> dict[str, list[bytes]]:
        """modality -> segments of one frame's map; ``batch_dict`` as from ``load_batch``, its vehicle unused."""
        with torch.no_grad():
            latents = self.model.encode_roadside(batch_dict)
        sent = {}
        for source, latent in latents.items():
            modality = source.partition("_")[2]
            stamp = MapStamp.at_pose(frame_id, time_us, modality, world_from_infra)
            values = np.ascontiguousarray(latent.values[0].cpu().numpy())
            precision = self.model.codec.codec_of(source).precision
            sent[modality] = encode_within(values, stamp, self.max_segment_bytes, precision, self.budget_bytes)
        return sent


class VehicleHalf:
    """Sensors and received maps to boxes: the vehicle's encoders and everything behind the link."""

    def __init__(self, model: nn.Module) -> None:
        self.model, self.shape = model.eval(), latent_shape(model)

    def detect(self, batch_dict: dict, world_from_ego: Pose, maps: Sequence[LatentMap]) -> dict[str, torch.Tensor]:
        """pred_boxes (n, 7), pred_scores (n,), pred_labels (n,) of one frame; ``maps``: any number, of one mast.

        ``batch_dict`` as from ``load_batch``, its roadside unused; the pose of the mast is the maps' own.
        """
        with torch.no_grad():
            batch = self.model.encode_vehicle(batch_dict)
            like = batch_dict["ego_from_infra"]
            batch["latents"] = {f"infra_{known.stamp.modality}": as_latent(known, like.device) for known in maps}
            if maps:
                ego_from_infra = world_from_ego.inverse() @ maps[0].stamp.world_from_agent
                batch["ego_from_infra"] = like.new_tensor(ego_from_infra.matrix)[None]
            return self.model.post_processing(self.model.fuse_and_detect(batch))[0][0]
