"""Latents to packets and back: where the network's tensors meet the bytes of ``link.packet``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from pcdet_avp.errors import ConfigError
from pcdet_avp.link.header import MapStamp
from pcdet_avp.link.map_size import UNLIMITED, MapSize
from pcdet_avp.link.packet import LatentMap
from pcdet_avp.models.compression.bev_codec import Latent


def precisions(codec: nn.Module, asked_by: str) -> dict[str, str]:
    """Precision of each modality's maps as sent; ``asked_by`` is the option that asked for bytes, for an error."""
    found = {modality: getattr(its_codec, "precision", None) for modality, its_codec in codec.codecs.items()}
    if None in found.values():
        raise ConfigError(f"{asked_by}: MODEL.COMPRESSION sends maps as they are; there are no bytes of them")
    return found


class MapPacker:
    """Writes latents as segments, each modality at the precision that its codec rounds to, so that nothing is lost; at
    the size that MODEL.COMPRESSION allows."""

    def __init__(
        self, codec: nn.Module, max_segment_bytes: int, asked_by: str, budget_bytes: int | None = None
    ) -> None:
        """``codec`` is the network's, ``asked_by`` as in ``precisions``.

        ``budget_bytes``: what a map may take, everything counted, where the codec allows more; None: what that allows.
        """
        self._precisions = precisions(codec, asked_by)
        self._max_segment_bytes, self._size = max_segment_bytes, codec.map_size.within(budget_bytes)
        self._size.check_segments(max_segment_bytes)

    def pack(self, values: Tensor, stamp: MapStamp) -> list[bytes]:
        """Segments of one map (c, h, w)."""
        return to_segments(values, stamp, self._max_segment_bytes, self._precisions[stamp.modality], self._size)


def to_segments(
    values: Tensor, stamp: MapStamp, max_segment_bytes: int, precision: str, size: MapSize = UNLIMITED
) -> list[bytes]:
    """Segments of one map (c, h, w); of one that is larger than ``size`` allows, those of its longest cells."""
    return size.pack(np.ascontiguousarray(values.detach().cpu().numpy()), stamp, max_segment_bytes, precision)


def as_latent(known: LatentMap, device: torch.device | str = "cpu") -> Latent:
    """What is known of a map, as a batch of one."""
    return as_latents([known], device)


def as_latents(known: Sequence[LatentMap], device: torch.device | str = "cpu") -> Latent:
    """What is known of several maps of one shape, as a batch."""
    values = torch.from_numpy(np.stack([each.values for each in known]))
    received = torch.from_numpy(np.stack([each.present for each in known]))
    return Latent(values.to(device), received[:, None].to(device))
