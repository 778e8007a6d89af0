"""Size of a Collective Perception Message in bytes, by the widths of its fields; and what comes on top on the air.

The message is coded in unaligned packed encoding rules (UPER, ITU-T X.691): a whole number between two bounds takes as
many bits as their difference needs, an optional or extensible field one bit more. The bounds are those of ETSI TS
103 324 V2.1.1 and TS 102 894-2 V2.4.1; a test holds the sums against messages that ``cpm_asn1`` encodes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from pcdet_avp.errors import PacketError


def _bits(low: int, high: int) -> int:
    return (high - low).bit_length()


# Every quantity travels with a confidence ("95 % within"); ours are coded unavailable and take their bits all the same.
_COORDINATE = _bits(-131_072, 131_071) + _bits(1, 4096)
_VELOCITY = _bits(-16_383, 16_383) + _bits(1, 127)
_YAW = _bits(0, 3601) + _bits(1, 127)
_SIZE = _bits(1, 256) + _bits(1, 32)
# Present or not: 14 optional fields, z of the position, z of the velocity, two more angles; extensible; which velocity.
_OBJECT = 1 + 14 + _bits(0, 65_535) + _bits(-2048, 2047) + (1 + 3 * _COORDINATE) + (2 + _YAW) + 3 * _SIZE
_VELOCITY_FIELD = 1 + 1 + 2 * _VELOCITY
# One class: how many there are, which of four kinds (extensible), its confidence; and the kind's own number.
_CLASS = _bits(1, 8) + (1 + 2) + _bits(1, 101)
_CLASS_NUMBER = {"Car": _bits(0, 14), "Pedestrian": (1 + 2) + _bits(0, 15), "Cyclist": (1 + 2) + _bits(0, 15)}
# Number of objects known and list of those told, both extensible.
_LIST = (1 + 8) + (1 + 8)
# Version, message, station; time; latitude, longitude, ellipse of confidence, altitude; containers: how many, which.
_HEADER = 8 + 8 + 32
_MANAGEMENT = 1 + (1 + 2) + 42 + (31 + 32 + 3 * 12 + 20 + 4)
_CONTAINERS = (1 + _bits(1, 8)) + _bits(1, 16)

SIGNERS = ("digest", "certificate")
# ETSI TS 103 097 V1.3.1 (IEEE 1609.2): a signed message's own fields and P-256 signature (84), and its signer: the
# eight bytes by which a known certificate is named, or the whole certificate (139 with the CPM as its one permission).
_SIGNED, _SIGNER = 84, {"digest": 9, "certificate": 142}
# Two sensors, each with number, kind and a sector of a circle as its region; TS 103 324 sends them about once a second.
SENSOR_CONTAINER_BYTES = 18
# ETSI EN 302 636-4-1 and -5-1: GeoNetworking's basic, common and single-hop headers, and BTP-B.
TRANSPORT_BYTES = 4 + 8 + 28 + 4


def object_bits(name: str, velocity: bool = True) -> int:
    """Bits of one object of a class of ``cpm.CLASSES``: identity, time, position, yaw, sizes, class; velocity."""
    if name not in _CLASS_NUMBER:
        raise PacketError(f"CPM: expected a class of {', '.join(_CLASS_NUMBER)}, found {name}")
    return _OBJECT + _CLASS + _CLASS_NUMBER[name] + (_VELOCITY_FIELD if velocity else 0)


def message_bytes(names: Sequence[str], velocity: bool = True) -> int:
    """Bytes of a message about objects of these classes, neither signed nor with headers of transport.

    About 33 + 32.1 n for n cars, 33 + 26.4 n without ``velocity`` (whether it is known or coded unavailable).
    """
    content = math.ceil((_LIST + sum(object_bits(name, velocity) for name in names)) / 8)
    length = 1 if content < 128 else 2
    return math.ceil((_HEADER + 1 + _MANAGEMENT + _CONTAINERS) / 8 + length + content)


def security_bytes(message_size: int, signer: str = "digest") -> int:
    """What a signature adds to a message of so many bytes; the signer is named by ``digest`` or ``certificate``."""
    if signer not in SIGNERS:
        raise PacketError(f"CPM: expected a signer of {', '.join(SIGNERS)}, found {signer}")
    length = 1 if message_size < 128 else 2 if message_size < 256 else 3
    return _SIGNED + length + _SIGNER[signer]
