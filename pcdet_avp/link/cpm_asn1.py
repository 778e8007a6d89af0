"""Collective Perception Messages in ETSI's own encoding, from ETSI's own ASN.1 files, by asn1tools (extra ``cpm``).

The files are ETSI's (BSD-3) and no part of this package: a checkout of ETSI's repository ``cpm_ts103324`` with its
submodule ``cdd_ts102894_2`` has all of them.

asn1tools leaves the content of a container as bytes, so containers are encoded first. The bounds that it would lose
are put right by ``asn1_files.with_whole_bounds``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pcdet_avp.errors import ConfigError, PacketError
from pcdet_avp.link.asn1_files import ENCODING, files_needed, with_whole_bounds
from pcdet_avp.link.cpm import CLASSES, OBJECT, SIZE_UNAVAILABLE, VELOCITY_UNAVAILABLE, YAW_UNAVAILABLE

MESSAGE_MODULE = "CPM-PDU-Descriptions"
PROTOCOL_VERSION, CPM_MESSAGE_ID, OBJECT_CONTAINER = 2, 14, 5
COORDINATE_UNKNOWN, ANGLE_UNKNOWN, SIZE_UNKNOWN, SPEED_UNKNOWN = 4096, 127, 32, 127


@dataclass(frozen=True)
class Station:
    """Sender of a message and its place: id, milliseconds since 2004-01-01 (TAI), degrees; None: coded unavailable."""

    station_id: int = 0
    time_ms: int = 0
    latitude_deg: float | None = None
    longitude_deg: float | None = None


class CpmCodec:
    """Encodes and decodes messages about objects as ``cpm.quantise`` makes them."""

    def __init__(self, specification: Any) -> None:
        self.specification = specification

    @classmethod
    def from_folder(cls, folder: Path) -> CpmCodec:
        """From a folder with ETSI's ASN.1 files, at any depth. Raises ConfigError where one is missing or unreadable.

        Takes seconds: the dictionary has 380 types.
        """
        asn1tools = _asn1tools()
        files = files_needed(Path(folder), MESSAGE_MODULE)
        try:
            modules = asn1tools.parse_files([str(file) for file in files], encoding=ENCODING)
            return cls(asn1tools.compile_dict(with_whole_bounds(modules), "uper"))
        except asn1tools.Error as error:
            raise ConfigError(f"{folder}: expected ETSI's ASN.1 files of the CPM, found {error}") from error

    def encode(self, objects: np.ndarray, station: Station = Station(), velocity: bool = True) -> bytes:
        """A message about objects (n,) of ``cpm.OBJECT``; without ``velocity`` that field is absent.

        Raises PacketError where a value does not fit the specification.
        """
        container = {
            "numberOfPerceivedObjects": len(objects),
            "perceivedObjects": [_to_asn1(one, velocity) for one in objects],
        }
        content = self._encode("PerceivedObjectContainer", container)
        payload = {
            "managementContainer": _management(station),
            "cpmContainers": [{"containerId": OBJECT_CONTAINER, "containerData": content}],
        }
        header = {"protocolVersion": PROTOCOL_VERSION, "messageId": CPM_MESSAGE_ID, "stationId": station.station_id}
        return self._encode("CollectivePerceptionMessage", {"header": header, "payload": payload})

    def decode(self, payload: bytes) -> np.ndarray:
        """A message's objects (n,) of ``cpm.OBJECT``. Raises PacketError where it is damaged or of another kind."""
        message = self._decode("CollectivePerceptionMessage", payload)
        if message["header"]["messageId"] != CPM_MESSAGE_ID:
            raise PacketError(f"CPM: expected message {CPM_MESSAGE_ID}, found {message['header']['messageId']}")
        objects = []
        for container in message["payload"]["cpmContainers"]:
            if container["containerId"] == OBJECT_CONTAINER:
                objects += self._decode("PerceivedObjectContainer", container["containerData"])["perceivedObjects"]
        return np.array([_from_asn1(one) for one in objects], OBJECT)

    def _encode(self, name: str, value: Mapping) -> bytes:
        try:
            return self.specification.encode(name, value, check_constraints=True)
        except _asn1tools().Error as error:
            raise PacketError(f"CPM: {error}") from error

    def _decode(self, name: str, payload: bytes) -> dict:
        try:
            return self.specification.decode(name, payload, check_constraints=True)
        except (_asn1tools().Error, LookupError, ValueError, NotImplementedError) as error:
            raise PacketError(f"CPM: damaged or foreign message: {error}") from error


def _asn1tools() -> Any:
    try:
        import asn1tools
    except ImportError as error:
        raise ConfigError("CPM in ASN.1: expected asn1tools, found none: pip install 'pcdet_avp[cpm]'") from error
    return asn1tools


def _management(station: Station) -> dict:
    """Station's time and place; nothing that is optional."""
    latitude, longitude = 900_000_001, 1_800_000_001  # unavailable
    if station.latitude_deg is not None and station.longitude_deg is not None:
        latitude, longitude = round(1e7 * station.latitude_deg), round(1e7 * station.longitude_deg)
    position = {
        "latitude": latitude,
        "longitude": longitude,
        "positionConfidenceEllipse": {
            "semiMajorConfidence": 4095,
            "semiMinorConfidence": 4095,
            "semiMajorOrientation": 3601,
        },
        "altitude": {"altitudeValue": 800_001, "altitudeConfidence": "unavailable"},
    }
    return {"referenceTime": station.time_ms, "referencePosition": position}


def _to_asn1(one: np.void, velocity: bool) -> dict:
    """One object as asn1tools takes it; every confidence unavailable, but that of the class."""
    x, y, z = (_with_confidence(value, COORDINATE_UNKNOWN) for value in one["position"])
    length, width, height = (_with_confidence(value, SIZE_UNKNOWN) for value in one["size"])
    kind, value = list(CLASSES.values())[one["kind"]]
    found = {
        "objectId": int(one["id"]),
        "measurementDeltaTime": int(one["delta_time"]),
        "position": {"xCoordinate": x, "yCoordinate": y, "zCoordinate": z},
        "angles": {"zAngle": _with_confidence(one["yaw"], ANGLE_UNKNOWN)},
        "objectDimensionZ": height,
        "objectDimensionY": width,
        "objectDimensionX": length,
        "classification": [{"objectClass": (kind, value), "confidence": int(one["confidence"])}],
    }
    if velocity:
        vx, vy = (_with_confidence(value, SPEED_UNKNOWN) for value in one["velocity"])
        found["velocity"] = ("cartesianVelocity", {"xVelocity": vx, "yVelocity": vy})
    return found


def _with_confidence(value: int, unknown: int) -> dict:
    return {"value": int(value), "confidence": unknown}


def _from_asn1(found: Mapping) -> tuple:
    """The fields of ``cpm.OBJECT``; what is optional and absent becomes "unavailable". A class of ours is expected."""
    ours = [
        kind
        for kind, value in enumerate(CLASSES.values())
        for c in found.get("classification", ())
        if c["objectClass"] == value
    ]
    if len(ours) != 1 or "zCoordinate" not in found["position"] or "objectId" not in found:
        expected = f"an object with an id, a z coordinate and one class of {', '.join(CLASSES)}"
        raise PacketError(f"CPM: expected {expected}, found {dict(found)}")
    kind, velocity = found.get("velocity", ("cartesianVelocity", {}))
    if kind != "cartesianVelocity":
        raise PacketError(f"CPM: expected a Cartesian velocity, found {kind}")
    return (
        found["objectId"],
        found["measurementDeltaTime"],
        [found["position"][f"{axis}Coordinate"]["value"] for axis in "xyz"],
        [velocity[f"{axis}Velocity"]["value"] if velocity else VELOCITY_UNAVAILABLE for axis in "xy"],
        found["angles"]["zAngle"]["value"] if "angles" in found else YAW_UNAVAILABLE,
        [found[f"objectDimension{a}"]["value"] if f"objectDimension{a}" in found else SIZE_UNAVAILABLE for a in "XYZ"],
        ours[0],
        found["classification"][0]["confidence"],
    )
