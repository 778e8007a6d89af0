"""The garage's mesh: floor and ceiling, walls, pillars, beams; markings and fittings have modules of their own.

World frame of ``garage``. Surfaces are textured by the camera from their world position, so that a few thousand
triangles are enough.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pcdet_avp.sim.garage import GarageLayout, Pillar, Wall
from pcdet_avp.sim.meshes.fittings import fittings_mesh
from pcdet_avp.sim.meshes.loft import quad
from pcdet_avp.sim.meshes.markings import markings_mesh
from pcdet_avp.sim.meshes.mesh import Material, Mesh, box_mesh
from pcdet_avp.structures.pose import Pose

WHITEWASH, CEILING_GREY = (0.46, 0.46, 0.44), (0.36, 0.36, 0.35)
FLOORS = ((0.20, 0.20, 0.195), (0.15, 0.16, 0.17), (0.14, 0.19, 0.16), (0.24, 0.23, 0.21))
BANDS = ((0.42, 0.28, 0.02), (0.03, 0.12, 0.32), (0.04, 0.24, 0.13), (0.40, 0.05, 0.03), (0.10, 0.30, 0.33))
YELLOW, BLACK = (0.62, 0.42, 0.02), (0.02, 0.02, 0.02)
BAND_M = (0.95, 1.25)  # painted band of the walls
STRIPES_M = (0.15, 1.15)  # hazard stripes of the pillars
BEAM_WIDTH_M = 0.35
LAMP_CLEARANCE_M = 1.1  # between the middles of a beam and a lamp
PAINT_M = 0.004  # paint stands off the concrete, so that rays meet it first


@lru_cache(maxsize=4)
def building_mesh(layout: GarageLayout) -> Mesh:
    """Everything of the layout that stands still, except the parked cars; world frame."""
    rng = np.random.default_rng(layout.style)
    floor, band, whitewash = draw_paint(rng)
    parts = [*slabs(outline(layout), layout.ceiling_m, floor), *_beams(layout, whitewash)]
    parts += [mesh for wall in layout.walls for mesh in wall_meshes(wall, whitewash, band)]
    parts += [mesh for pillar in layout.pillars for mesh in pillar_meshes(pillar, layout.ceiling_m, whitewash)]
    return Mesh.merge([*parts, markings_mesh(layout, rng), fittings_mesh(layout, rng)])


def outline(layout: GarageLayout) -> tuple[float, float, float, float]:
    """x_min, y_min, x_max, y_max of everything that the walls enclose, metres."""
    ends = np.array([[(w.x0, w.y0), (w.x1, w.y1)] for w in layout.walls]).reshape(-1, 2)
    ends = np.concatenate([ends, [[layout.road_start_x, -10.0], [layout.road_end_x, 10.0]]])
    return (*(ends.min(0) - 1.0).tolist(), *(ends.max(0) + 1.0).tolist())


def draw_paint(rng: np.random.Generator) -> tuple[tuple, tuple, tuple]:
    """Linear RGB of a garage's floor, of the band on its walls, and of its whitewash."""
    floor, band = (palette[rng.integers(len(palette))] for palette in (FLOORS, BANDS))
    return floor, band, tuple(np.array(WHITEWASH) * rng.uniform(0.75, 1.1))


def slabs(extent: tuple[float, float, float, float], ceiling_m: float, color) -> list[Mesh]:
    """Floor and ceiling over x_min, y_min, x_max, y_max, each one rectangle."""
    x0, y0, x1, y1 = extent
    z = ceiling_m
    return [
        quad((x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0), color, Material.FLOOR),
        quad((x0, y1, z), (x1, y1, z), (x1, y0, z), (x0, y0, z), CEILING_GREY, Material.CONCRETE),
    ]


def wall_meshes(wall: Wall, color, band) -> list[Mesh]:
    """Boxes one above the other: bare, painted band, bare; a parapet is bare with a painted cap, a ramp's wall bare."""
    if wall.end_height is not None:
        return [_ramp_wall(wall, color)]
    if wall.height < 2.0:
        levels = [(0.0, wall.height - 0.12, color), (wall.height - 0.12, wall.height, YELLOW)]
    else:
        levels = [(0.0, BAND_M[0], color), (*BAND_M, band), (BAND_M[1], wall.height, color)]
    dx, dy = wall.x1 - wall.x0, wall.y1 - wall.y0
    pose = Pose.from_xyz_yaw((wall.x0 + wall.x1) / 2, (wall.y0 + wall.y1) / 2, yaw=float(np.arctan2(dy, dx)))
    boxes = [
        box_mesh((np.hypot(dx, dy), wall.thickness, high - low), (0, 0, (low + high) / 2), paint, Material.CONCRETE)
        for low, high, paint in levels
    ]
    return [box.transformed(pose) for box in boxes]


def _ramp_wall(wall: Wall, color) -> Mesh:
    """A box whose top slopes from ``height`` at its first point to ``end_height`` at its second."""
    dx, dy = wall.x1 - wall.x0, wall.y1 - wall.y0
    length = float(np.hypot(dx, dy))
    box = box_mesh((length, wall.thickness, 1.0), (length / 2, 0, 0.5), color, Material.CONCRETE)
    vertices = box.vertices.copy()
    vertices[:, 2] *= wall.height + vertices[:, 0] / length * (wall.end_height - wall.height)
    pose = Pose.from_xyz_yaw(wall.x0, wall.y0, yaw=float(np.arctan2(dy, dx)))
    return Mesh.flat(vertices, box.faces, color, Material.CONCRETE).transformed(pose)


def pillar_meshes(pillar: Pillar, ceiling: float, color) -> list[Mesh]:
    """A shaft with slanting yellow and black stripes at bumper height."""
    shaft = box_mesh((pillar.size, pillar.size, ceiling), (0, 0, ceiling / 2), color, Material.CONCRETE)
    faces = [_stripes(pillar.size).transformed(Pose.from_xyz_yaw(0, 0, yaw=k * np.pi / 2)) for k in range(4)]
    pose = Pose.from_xyz_yaw(pillar.x, pillar.y, yaw=pillar.heading)
    return [mesh.transformed(pose) for mesh in (shaft, *faces)]


def _stripes(size: float) -> Mesh:
    """Stripes of a pillar's face towards +x."""
    x, half, (low, high) = size / 2 + PAINT_M, size / 2, STRIPES_M
    count = 5
    step = (high - low) / count
    quads = []
    for k in range(count):
        a, b = low + k * step, low + (k + 1) * step
        slant = min(step, high - b) if k < count - 1 else 0.0
        lift = step if k > 0 else 0.0
        corners = (x, -half, a + 0.0), (x, half, a + lift), (x, half, b + slant), (x, -half, b)
        quads.append(quad(*corners, BLACK if k % 2 else YELLOW, Material.CONCRETE))
    return Mesh.merge(quads)


def _beams(layout: GarageLayout, color) -> list[Mesh]:
    """Beams across the road near the pillars, clear of the lamps and too shallow to hide anything from the mast."""
    _, y0, _, y1 = outline(layout)
    deep, z = 0.05 * layout.ceiling_m, layout.ceiling_m
    lamps = np.array([lamp.x for lamp in layout.lamps])
    places: list[float] = []
    for x in sorted({round(p.x, 2) for p in layout.pillars if abs(p.x) > 2.0}):
        free = [x + d for d in (0.0, 0.7, -0.7, 1.4, -1.4) if not (np.abs(lamps - x - d) < LAMP_CLEARANCE_M).any()]
        if free and (not places or free[0] - places[-1] > 3.0):
            places.append(free[0])
    size = (BEAM_WIDTH_M, y1 - y0, deep)
    return [box_mesh(size, (x, (y0 + y1) / 2, z - deep / 2), color, Material.CONCRETE) for x in places]
