"""Latents to packets and back: where the network's tensors meet the bytes of ``link.packet``."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from pcdet_avp.errors import ConfigError
from pcdet_avp.link.header import MapStamp
from pcdet_avp.link.packet import LatentMap, encode
from pcdet_avp.models.compression.bev_codec import Latent
from pcdet_avp.models.compression.latent_arrays import to_arrays


class MapPacker:
    """Writes latents as segments, each modality at the precision that its codec rounds to, so that nothing is lost."""

    def __init__(self, codec: nn.Module, max_segment_bytes: int, asked_by: str) -> None:
        """``codec`` is the network's; ``asked_by`` names the wish for bytes where it cannot be granted."""
        self._precisions = {name: getattr(of_modality, "precision", None) for name, of_modality in codec.codecs.items()}
        if None in self._precisions.values():
            raise ConfigError(f"{asked_by}: MODEL.COMPRESSION sends maps as they are; there is no packet for that")
        self._max_segment_bytes = max_segment_bytes

    def pack(self, values: Tensor, stamp: MapStamp) -> list[bytes]:
        """Segments of one map (c, h, w)."""
        precision = self._precisions[stamp.modality]
        array = np.ascontiguousarray(values.detach().cpu().numpy())
        return encode(array, stamp, self._max_segment_bytes, precision, to_arrays(values, precision).exponents)


def as_latent(known: LatentMap, device: torch.device | str = "cpu") -> Latent:
    """What is known of a map, as a batch of one."""
    values, received = torch.from_numpy(known.values), torch.from_numpy(known.present)
    return Latent(values[None].to(device), received[None, None].to(device))
