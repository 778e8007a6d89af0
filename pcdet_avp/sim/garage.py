"""The garage's plan, drawn per scene: road, slots, T-junction, pillars, walls, lamps.

World frame: the origin lies on the floor below the roadside mast, on the axis of the straight road; the ego
drives towards +x (in the right lane, y = -lane/2), the mast looks back along -x. A wall closes the road just
behind the mast. The side road joins from the ego's right (y < 0); its exiting lane lies at ``exit_lane_x``. Between
side road and mast there are only parapets, so that the mast overlooks the exiting lane.

``sim/layouts.py`` draws a plan.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

# Paper, section "Simulation Environment".
LANE_WIDTH_M = 3.4
SLOT_WIDTH_M = 3.2
SLOT_DEPTH_M = 5.8
TUBE_HALF_LENGTH_M = 0.6  # a lamp is a tube along the world's x axis (ours)


@dataclass(frozen=True)
class Slot:
    """A parking slot: centre x, y, the heading of its axis pointing from the road inwards, width and depth (m).

    Drawn garages have perpendicular slots of the paper's size only; those of a plan stand at any angle.
    """

    x: float
    y: float
    heading: float  # rad: in drawn garages +pi/2 for the row at y > 0, -pi/2 for the row at y < 0
    width: float = SLOT_WIDTH_M
    depth: float = SLOT_DEPTH_M

    @property
    def box(self) -> tuple[float, float, float, float, float, float, float]:
        """Its floor as x, y, z, dx, dy, dz, heading, one metre high."""
        return self.x, self.y, 0.5, self.depth, self.width, 1.0, self.heading


@dataclass(frozen=True)
class Pillar:
    """A square pillar from floor to ceiling."""

    x: float
    y: float
    size: float
    heading: float = 0.0  # rad, of one of its sides


@dataclass(frozen=True)
class Wall:
    """A straight wall between two floor points, ``height`` tall (a parapet where lower than the ceiling).

    ``end_height``: a ramp's wall, whose top rises or falls evenly to so much at its second point.
    """

    x0: float
    y0: float
    x1: float
    y1: float
    height: float
    thickness: float = 0.2
    end_height: float | None = None

    @property
    def top(self) -> float:
        """Height of its highest point, m."""
        return self.height if self.end_height is None else max(self.height, self.end_height)

    @property
    def box(self) -> tuple[float, float, float, float, float, float, float]:
        """Its body as x, y, z, dx, dy, dz, heading."""
        along = self.x1 - self.x0, self.y1 - self.y0
        size = float(np.hypot(*along)), self.thickness, self.top
        centre = (self.x0 + self.x1) / 2, (self.y0 + self.y1) / 2, self.top / 2
        return (*centre, *size, float(np.arctan2(along[1], along[0])))


@dataclass(frozen=True)
class Lamp:
    """A ceiling lamp: centre, radiant intensity (relative; 1 is a healthy tube), linear RGB tint. Failed ones are 0."""

    x: float
    y: float
    z: float
    intensity: float
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class GarageLayout:
    """Everything that stands still, except the parked cars."""

    road_start_x: float  # far end of the road (negative, m)
    road_end_x: float  # face of the wall behind the mast (m)
    junction_x: float  # centre line of the side road (negative, m)
    side_road_end_y: float  # far end of the side road (negative, m)
    ceiling_m: float
    slots: tuple[Slot, ...]
    pillars: tuple[Pillar, ...]
    walls: tuple[Wall, ...]
    lamps: tuple[Lamp, ...]
    style: int  # seed of paint bands, stains and other decoration

    @property
    def lane_y(self) -> float:
        """Lateral position of the ego's lane centre."""
        return -LANE_WIDTH_M / 2

    @property
    def exit_lane_x(self) -> float:
        """Centre of the side road's lane that leads to the road (right-hand traffic towards +y)."""
        return self.junction_x + LANE_WIDTH_M / 2

    @property
    def entry_lane_x(self) -> float:
        """Centre of the side road's lane that leads away from the road (towards -y)."""
        return self.junction_x - LANE_WIDTH_M / 2

    def slot_gaps(self) -> np.ndarray:
        """(G, 3) x, y, heading of the mouths of the gaps between neighbouring slots of a row (no pillar between)."""
        gaps = [self.gap_between(a, b) for a, b in self.neighbours()]
        return np.array(gaps).reshape(-1, 3)

    def neighbours(self) -> list[tuple[Slot, Slot]]:
        """Pairs of slots that share a long side, by row and x."""
        row = sorted(self.slots, key=lambda slot: (slot.heading, slot.x))
        return [(a, b) for a, b in pairwise(row) if a.heading == b.heading and abs(b.x - a.x - SLOT_WIDTH_M) < 0.05]

    @staticmethod
    def gap_between(a: Slot, b: Slot) -> tuple[float, float, float]:
        """x, y, heading of the point where the line between two slots meets the road."""
        return (a.x + b.x) / 2, float(np.sign(a.y)) * LANE_WIDTH_M, a.heading

    def solid_boxes(self) -> np.ndarray:
        """(M, 7) boxes of pillars and walls: where nobody can be."""
        pillars = [(p.x, p.y, self.ceiling_m / 2, p.size, p.size, self.ceiling_m, 0.0) for p in self.pillars]
        return np.array(pillars + [wall.box for wall in self.walls]).reshape(-1, 7)
