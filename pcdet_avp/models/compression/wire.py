"""The roadside's maps as bytes and back: what ``--wire`` puts between compressor and decompressor."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from pcdet_avp.link.header import MapStamp
from pcdet_avp.link.nr_v2x import NrV2xConfig
from pcdet_avp.link.packet import decode
from pcdet_avp.models.compression.bev_codec import Latent
from pcdet_avp.models.compression.map_packets import MapPacker, as_latent
from pcdet_avp.structures.sensor_set import modality_of


class Wire:
    """A link for ``AvpCp.forward`` that loses nothing: only bytes reach the vehicle. It notes how many."""

    def __init__(self, codec: nn.Module, max_segment_bytes: int = NrV2xConfig().max_segment_bytes) -> None:
        """``codec`` is the network's; segments fit one transport block by default."""
        self._packer = MapPacker(codec, max_segment_bytes, "--wire")
        self._sent: dict[str, list[int]] = {}
        self._maps = 0

    def __call__(self, latents: Mapping[str, Latent]) -> dict[str, Latent]:
        """{source: Latent} as the roadside made them -> as the vehicle decoded them."""
        return {source: self._transmit(latent, modality_of(source)) for source, latent in latents.items()}

    def take_sizes(self) -> dict[str, list[int]]:
        """Bytes of every map sent since the last call, headers and checksums counted, by modality."""
        sizes, self._sent = self._sent, {}
        return sizes

    def _transmit(self, latent: Latent, modality: str) -> Latent:
        values, received = torch.zeros_like(latent.values), torch.zeros_like(latent.received)
        for row in latent.received.flatten(1).any(1).nonzero().flatten().tolist():
            known = as_latent(decode(self._pack(latent.values[row], modality)), values.device)
            values[row], received[row] = known.values[0], known.received[0]
        return Latent(values, received)

    def _pack(self, values: Tensor, modality: str) -> list[bytes]:
        """Segments of one map (c, h, w). The stamp is a counter: frames of a test have no clock."""
        payloads = self._packer.pack(values, MapStamp(self._maps, 0, modality, 0.0, 0.0, 0.0))
        self._maps += 1
        self._sent.setdefault(modality, []).append(sum(map(len, payloads)))
        return payloads
