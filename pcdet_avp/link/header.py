"""What a segment says about itself: which capture the map shows, how it is written, and which cells it carries."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcdet_avp.errors import PacketError
from pcdet_avp.link.precision import LARGEST_EXPONENT, PRECISIONS
from pcdet_avp.structures.pose import Pose

MODALITIES = ("camera", "lidar")
# Largest map that is sent or read: 64 channels of 376 x 280 cells fit, an announced gigabyte does not.
MAX_ELEMENTS = 1 << 23
MAX_SENDERS = 1 << 16  # numbers that a roadside unit can have
MAX_ROUNDING_M = 0.01  # of x and y as float32, which has steps of 8 mm from 65 km on, of half a metre in UTM northings


@dataclass(frozen=True)
class MapStamp:
    """Which capture a map shows: frame id, time in microseconds, modality, the planar pose world_from_agent, sender,
    network.

    The pose travels, and is kept here, as float32: metres, metres, radians; PacketError where that would move it by
    more than a centimetre. ``sender`` is the number of the roadside unit at its site, 0 to 65535; a site's only unit is
    number 0. ``network`` is the number of the network that made the map (see ``network_number``), 0: not said.
    """

    frame_id: int
    time_us: int
    modality: str
    x_m: float
    y_m: float
    yaw_rad: float
    sender: int = 0
    network: int = 0

    def __post_init__(self) -> None:
        if self.modality not in MODALITIES:
            raise PacketError(f"modality: expected one of {', '.join(MODALITIES)}, found {self.modality!r}")
        if not 0 <= self.frame_id < 1 << 32 or not 0 <= self.time_us < 1 << 64:
            raise PacketError(f"frame id {self.frame_id} or time {self.time_us} us is outside 32 or 64 bits")
        if not 0 <= self.sender < MAX_SENDERS:
            raise PacketError(f"sender: expected a unit's number from 0 to {MAX_SENDERS - 1}, found {self.sender}")
        if not 0 <= self.network < 1 << 32:
            raise PacketError(f"network: expected a number of 32 bits, found {self.network}")
        with np.errstate(over="ignore"):
            pose = [float(np.float32(getattr(self, name))) for name in ("x_m", "y_m", "yaw_rad")]
        if not np.isfinite(pose).all():
            raise PacketError(f"pose: expected finite x, y and yaw, found {pose}")
        off_m = max(abs(pose[0] - self.x_m), abs(pose[1] - self.y_m))
        if off_m > MAX_ROUNDING_M:
            raise PacketError(
                f"pose: x {self.x_m:.3f} and y {self.y_m:.3f} m travel as float32, which moves them by {off_m:.2g} m: "
                "expected a frame of the site, whose origin is near"
            )
        for name, value in zip(("x_m", "y_m", "yaw_rad"), pose, strict=True):
            object.__setattr__(self, name, value)

    @classmethod
    def at_pose(
        cls, frame_id: int, time_us: int, modality: str, world_from_agent: Pose, sender: int = 0, network: int = 0
    ) -> MapStamp:
        """The stamp of a map that was taken at a pose; height, roll and pitch are not sent."""
        x, y = world_from_agent.translation[:2]
        return cls(frame_id, time_us, modality, float(x), float(y), world_from_agent.yaw, sender, network)

    @property
    def world_from_agent(self) -> Pose:
        """The sender's pose in the plane."""
        return Pose.from_xyz_yaw(self.x_m, self.y_m, yaw=self.yaw_rad)


def network_number(weights_hash: str) -> int:
    """The number of the network with this hash of its weights (hexadecimal): the first 32 bits of it.

    Maps are a network's own language: another one makes nonsense of them, without an error. Two networks have the same
    number with a probability of 2e-10.
    """
    return int(weights_hash[:8], 16)


@dataclass(frozen=True)
class MapFormat:
    """Format of a map (channels, height, width) as sent; int8 has, per channel, the exponent of its power of two."""

    channels: int
    height: int
    width: int
    precision: str
    exponents: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.precision not in PRECISIONS:
            raise PacketError(f"precision: expected one of {', '.join(PRECISIONS)}, found {self.precision!r}")
        if not (0 < self.channels < 1 << 8 and 0 < self.height < 1 << 16 and 0 < self.width < 1 << 16):
            raise PacketError(f"map shape: expected 1-255 channels and 1-65535 rows and columns, found {self.shape}")
        if self.channels * self.cells > MAX_ELEMENTS:
            raise PacketError(f"map shape: {self.shape} is more than {MAX_ELEMENTS} elements")
        expected = self.channels if self.precision == "int8" else 0
        if len(self.exponents) != expected or any(abs(e) > LARGEST_EXPONENT for e in self.exponents):
            raise PacketError(
                f"{self.precision} map: expected {expected} exponents of -120 to 120, found {self.exponents}"
            )

    @property
    def shape(self) -> tuple[int, int, int]:
        """(C, H, W)."""
        return self.channels, self.height, self.width

    @property
    def cells(self) -> int:
        """H * W."""
        return self.height * self.width


@dataclass(frozen=True)
class SegmentHeader:
    """Cells [first_cell, first_cell + cell_count) of a map, in raster order."""

    stamp: MapStamp
    format: MapFormat
    first_cell: int
    cell_count: int

    def __post_init__(self) -> None:
        if self.cell_count < 1 or self.first_cell < 0 or self.first_cell + self.cell_count > self.format.cells:
            raise PacketError(
                f"segment: {self.cell_count} cells from {self.first_cell} do not lie in a map of {self.format.cells}"
            )
