"""Bytes on the air: a real wire format for sparse BEV maps, and an NR-V2X link that loses and delays them.

``packet`` turns a map into segments and back, ``receiver`` puts together what arrived, ``channel`` is the air in
between. numpy and numba only; nothing here imports torch.
"""

from pcdet_avp.link.channel import Delivery, IdealChannel, NrV2xChannel
from pcdet_avp.link.header import MapStamp, network_number
from pcdet_avp.link.loss import LossModel
from pcdet_avp.link.map_size import MapSize
from pcdet_avp.link.nr_v2x import NrV2xConfig
from pcdet_avp.link.packet import LatentMap, decode, encode
from pcdet_avp.link.precision import int8_exponents, rounded
from pcdet_avp.link.rate_control import encode_constant, encode_within
from pcdet_avp.link.receiver import Receiver

__all__ = [
    "Delivery",
    "IdealChannel",
    "LatentMap",
    "LossModel",
    "MapSize",
    "MapStamp",
    "NrV2xChannel",
    "NrV2xConfig",
    "Receiver",
    "decode",
    "encode",
    "encode_constant",
    "encode_within",
    "int8_exponents",
    "network_number",
    "rounded",
]
