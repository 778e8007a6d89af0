"""The trained half of the compression of roadside maps (paper, section "Feature Compression").

All of it is in the training graph, so that what the network is trained with is what is transmitted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from pcdet_avp.link.map_size import MapSize
from pcdet_avp.models.compression.map_codec import MapCodec, UncompressedMap
from pcdet_avp.registry import COMPRESSION
from pcdet_avp.structures.sensor_set import INFRA_SOURCES, SOURCES, modality_of


@dataclass(frozen=True, eq=False)
class Latent:
    """A compressed map as the vehicle holds it.

    values (B, c, h, w) float32, exactly zero in cells that were not worth sending and where nothing was received.
    received (B, 1, h, w) bool: a cell of a map that arrived is present even if it is empty.
    """

    values: Tensor
    received: Tensor

    def sparse(self, sample: int = 0) -> Tensor:
        """One sample's map as torch's hybrid sparse tensor (h, w, c): where its occupied cells are, and their vectors.

        For senders of maps that do not use ``link.packet``; ``to_dense()`` gives the map back.
        """
        values = self.values[sample]
        rows, columns = (values != 0).any(0).nonzero(as_tuple=True)
        vectors, shape = values[:, rows, columns].T, (*values.shape[1:], len(values))
        return torch.sparse_coo_tensor(torch.stack([rows, columns]), vectors, shape, check_invariants=True).coalesce()


@COMPRESSION.register("BevCodec")
class BevCodec(nn.Module):
    """Both roadside maps, each with its own ``MapCodec``, named ``camera`` and ``lidar``.

    Keys: REDUCTION 8; PRECISION float16 | int8; THRESHOLD, TARGET_SHARE, MAX_SHARE, LOSS_WEIGHT, INITIAL_LENGTH (see
    ``CellThreshold``); MAX_BYTES, CONSTANT_SIZE of the maps on the air (see ``link.map_size``).
    """

    map_codec: type[nn.Module] = MapCodec

    def __init__(self, model_cfg: Any, channels: int) -> None:
        super().__init__()
        self.codecs = nn.ModuleDict(
            {modality_of(source): self.map_codec(model_cfg, channels) for source in INFRA_SOURCES}
        )
        self.map_size = MapSize.from_config(model_cfg)

    def check_size(self, height: int, width: int, sender: int = 0, network: int = 0) -> None:
        """ConfigError where not even an empty map of a BEV grid of so many rows and columns fits MAX_BYTES, sent by the
        roadside unit of this number; ``network`` as in ``MapStamp``."""
        for codec in self.codecs.values():
            codec.check(self.map_size, height, width, sender, network)

    def codec_of(self, source: str) -> nn.Module:
        """The codec of a roadside source's modality."""
        return self.codecs[modality_of(source)]

    def compress(self, batch_dict: dict) -> dict:
        """What the roadside sends.

        Args: batch_dict:
            bev_maps {source: (B, C, H, W)}, source_present (B, 4)
        Returns: batch_dict with
            latents {roadside source: Latent}
            latent_losses {roadside source: (B,)}, zero where the source is not present
        """
        latents, losses = {}, {}
        for source in [s for s in INFRA_SOURCES if s in batch_dict["bev_maps"]]:
            present = batch_dict["source_present"][:, SOURCES.index(source)] > 0
            values, loss = self.codec_of(source).compress(batch_dict["bev_maps"][source])
            received = present[:, None, None, None].expand(-1, 1, *values.shape[2:])
            latents[source], losses[source] = Latent(torch.where(received, values, 0), received), loss * present
        return {**batch_dict, "latents": latents, "latent_losses": losses}

    def decompress(self, batch_dict: dict) -> dict:
        """What the vehicle makes of it. A roadside map without a latent did not arrive and is left out.

        Args: batch_dict:
            latents {roadside source: Latent}, bev_maps, bev_valid
        Returns: batch_dict with
            bev_maps, bev_valid of the roadside sources as received, still on the roadside's grid
        """
        maps = {source: m for source, m in batch_dict["bev_maps"].items() if source not in INFRA_SOURCES}
        valid = {source: v for source, v in batch_dict["bev_valid"].items() if source not in INFRA_SOURCES}
        for source, latent in batch_dict["latents"].items():
            codec = self.codec_of(source)
            maps[source] = codec.decompress(torch.where(latent.received, latent.values, 0))
            valid[source] = latent.received.repeat_interleave(codec.pooling, 2).repeat_interleave(codec.pooling, 3)
        return {**batch_dict, "bev_maps": maps, "bev_valid": valid}

    def get_loss(self, batch_dict: dict) -> tuple[Tensor, dict[str, Tensor]]:
        """The pressure towards TARGET_SHARE, and the share of empty cells in what was sent (paper: 0.82-0.88).

        Args: batch_dict:
            latents, latent_losses, source_present, batch_size
        """
        loss, tb_dict = batch_dict["source_present"].new_zeros(()), {}
        for source, losses in batch_dict["latent_losses"].items():
            loss = loss + losses.sum() / int(batch_dict["batch_size"])
            latent = batch_dict["latents"][source]
            occupied = (latent.values != 0).any(1).sum() / latent.received.sum().clamp_min(1)
            tb_dict[f"sparsity_{source}"] = 1 - occupied
        return loss, tb_dict | {"rate_loss": loss.detach()}


@COMPRESSION.register("NoCompression")
class NoCompression(BevCodec):
    """Roadside maps travel as they are, to measure what the compression costs."""

    map_codec = UncompressedMap
