"""What is fixed to the building: lamp housings, ducts, pipes, bumper stops, signs."""

from __future__ import annotations

import numpy as np

from pcdet_avp.sim.garage import LANE_WIDTH_M, SLOT_DEPTH_M, TUBE_HALF_LENGTH_M, GarageLayout, Lamp, Slot
from pcdet_avp.sim.meshes.loft import prism, quad
from pcdet_avp.sim.meshes.mesh import Material, Mesh, box_mesh

ZINC, PIPE_RED, PIPE_GREY = (0.40, 0.41, 0.42), (0.30, 0.03, 0.02), (0.25, 0.26, 0.27)
STOP_YELLOW = (0.50, 0.36, 0.03)
SIGN_BLUE, SIGN_GREEN, SIGN_WHITE = (0.01, 0.08, 0.36), (0.01, 0.25, 0.08), (0.65, 0.65, 0.65)


def fittings_mesh(layout: GarageLayout, rng: np.random.Generator) -> Mesh:
    """All fittings of a layout."""
    parts = [mesh for lamp in layout.lamps for mesh in lamp_meshes(lamp)]
    parts += [_bumper_stop(slot) for slot in layout.slots]
    return Mesh.merge([*parts, *_ducts(layout, rng), *_signs(layout)])


def lamp_meshes(lamp: Lamp) -> list[Mesh]:
    """A housing and its glowing face, which lies in the lamp's z."""
    length, half = 2 * TUBE_HALF_LENGTH_M, 0.07
    housing = box_mesh((length + 0.1, 0.2, 0.06), (lamp.x, lamp.y, lamp.z + 0.035), (0.5, 0.5, 0.5), Material.METAL)
    x0, x1, y0, y1, z = lamp.x - length / 2, lamp.x + length / 2, lamp.y - half, lamp.y + half, lamp.z
    glow = tuple(min(1.0, 0.02 + lamp.intensity * t) for t in lamp.tint)
    return [housing, quad((x0, y1, z), (x1, y1, z), (x1, y0, z), (x0, y0, z), glow, Material.LAMP)]


def _bumper_stop(slot: Slot) -> Mesh:
    """A low bar 0.8 m before the slot's end."""
    y = slot.y + np.sin(slot.heading) * (SLOT_DEPTH_M / 2 - 0.5)
    return box_mesh((1.7, 0.13, 0.1), (slot.x, y, 0.05), STOP_YELLOW, Material.RUBBER)


def _ducts(layout: GarageLayout, rng: np.random.Generator) -> list[Mesh]:
    """A ventilation duct above one row of slots, pipes above the other, under the ceiling all along the road."""
    x0, x1, z = layout.road_start_x, layout.road_end_x, layout.ceiling_m
    side = 1 if rng.uniform() < 0.5 else -1
    deep = 0.06 * z
    centre = ((x0 + x1) / 2, side * (LANE_WIDTH_M + 3.2), z - 0.05 * z - deep / 2)
    meshes = [box_mesh((x1 - x0, 0.9, deep), centre, ZINC, Material.METAL)]
    for k, (color, radius) in enumerate(((PIPE_RED, 0.07), (PIPE_GREY, 0.05), (PIPE_GREY, 0.05))):
        y = -side * (LANE_WIDTH_M + 2.4 + 0.35 * k)
        meshes.append(prism((x0, y, 0.94 * z), (x1, y, 0.94 * z), radius, 6, color, Material.CONCRETE))
    return meshes


def _signs(layout: GarageLayout) -> list[Mesh]:
    """Hanging direction signs before the junction and a way-out sign on the wall behind the mast."""
    way_out = box_mesh((0.06, 1.0, 0.35), (layout.road_end_x - 0.03, 2.6, 2.4), SIGN_GREEN, Material.PAINT)
    boards = [mesh for before in (7.0, 47.0) for mesh in _hanging_sign(layout.junction_x - before, layout.ceiling_m)]
    return [way_out, *boards]


def _hanging_sign(x: float, ceiling: float) -> list[Mesh]:
    """A board across the ego's lane, too high to hide anybody in the map from the mast, on two rods."""
    y, z = -LANE_WIDTH_M / 2, min(5.7, ceiling - 0.5)
    board = box_mesh((0.08, 1.6, 0.4), (x, y, z), SIGN_BLUE, Material.PAINT)
    rod = (0.03, 0.03, ceiling - z)
    rods = [box_mesh(rod, (x, y + s, (ceiling + z) / 2), ZINC, Material.METAL) for s in (-0.7, 0.7)]
    return [board, *rods, *_lettering(x - 0.045, y, z)]


def _lettering(x: float, y: float, z: float) -> list[Mesh]:
    """A white arrow to the right and two letters' bars on a board that faces -x; metres to the right of its middle."""
    bars = [(-0.45, 0.05, 0.04), (0.40, 0.49, 0.08), (0.55, 0.64, 0.08)]
    meshes = [
        quad(*((x, y - a, z + b) for a, b in ((s, -h), (e, -h), (e, h), (s, h))), SIGN_WHITE, Material.RETROREFLECTOR)
        for s, e, h in bars
    ]
    head = [(x, y, z - 0.12), (x, y - 0.2, z), (x, y, z + 0.12)]
    return [*meshes, Mesh.flat(head, [[0, 1, 2]], SIGN_WHITE, Material.RETROREFLECTOR)]
