"""A frame's roadside maps from the compressor over real segments and a lossy channel to the decompressor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pcdet_avp.bandwidth.plan import Transmission
from pcdet_avp.link import (
    LatentMap,
    LossModel,
    MapStamp,
    NrV2xChannel,
    NrV2xConfig,
    Receiver,
    decode,
)
from pcdet_avp.models.compression import Latent
from pcdet_avp.models.compression.map_packets import to_segments
from pcdet_avp.models.precision import full_precision
from pcdet_avp.structures.sensor_set import modality_of

# Long after the last block of any map.
LATER_S = 60.0


@dataclass(frozen=True)
class Sent:
    """A map on the air: its bytes, headers and checksums counted, its blocks, and the share of cells occupied."""

    bytes: int
    blocks: int
    occupied: float


def unsparsified(codec: nn.Module, x: Tensor) -> Tensor:
    """What ``MapCodec.compress`` makes of a map (B, C, H, W) before it drops cells and rounds."""
    return F.max_pool2d(codec.reduce(full_precision(x)), codec.pooling)


def transmit(
    latents: Mapping[str, Tensor], transmission: Transmission, mcs: int, rng: np.random.Generator
) -> tuple[dict[str, Latent], dict[str, Sent]]:
    """Latents (c, h, w) of a frame by source -> what the vehicle receives, each (1, c, h, w), and what went on the air.

    A map of which no segment arrives is left out.
    """
    if transmission.precision is None:
        return {source: as_latent(x, np.ones(x.shape[1:], bool)) for source, x in latents.items()}, {}
    config = NrV2xConfig(mcs=mcs, loss=LossModel.independent(transmission.loss))
    channel, receiver, sent = NrV2xChannel(config, rng), Receiver(), {}
    for source, latent in latents.items():
        payloads = segments_of(latent, modality_of(source), transmission, config.max_segment_bytes)
        sent[source] = sent_of(payloads)
        channel.send(source, payloads, 0.0)
    for delivery in channel.receive(LATER_S):
        receiver.push(delivery.payload)
    received = {source: receiver.take(modality_of(source), 0) for source in latents}
    arrived = {
        source: received_latent(known, latents[source]) for source, known in received.items() if known is not None
    }
    return arrived, sent


def segments_of(latent: Tensor, modality: str, transmission: Transmission, max_segment_bytes: int) -> list[bytes]:
    """The segments of one map (c, h, w); frames of a study have no clock and no pose of their own."""
    stamp = MapStamp(0, 0, modality, 0.0, 0.0, 0.0)
    return to_segments(latent, stamp, max_segment_bytes, transmission.precision, transmission.size)


def sent_of(payloads: list[bytes]) -> Sent:
    """What the segments of one map amount to."""
    return Sent(sum(map(len, payloads)), len(payloads), float(decode(payloads).values.any(0).mean()))


def as_latent(values: Tensor, present: np.ndarray) -> Latent:
    """A batch of one from values (c, h, w) and present (h, w)."""
    return Latent(values[None], torch.from_numpy(present).to(values.device)[None, None])


def received_latent(known: LatentMap, like: Tensor) -> Latent:
    """A received map in the memory format of the sent one, on which the last bit of a convolution depends."""
    return as_latent(torch.empty_like(like).copy_(torch.from_numpy(known.values)), known.present)
