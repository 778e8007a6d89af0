"""What is bolted to a car's body: wheels, mirrors, number plates, shut lines, door handles."""

from __future__ import annotations

import numpy as np

from pcdet_avp.sim.meshes.car_body import DARK, Profile
from pcdet_avp.sim.meshes.car_spec import CarSpec
from pcdet_avp.sim.meshes.loft import grid_faces, painted, quad
from pcdet_avp.sim.meshes.mesh import Material, Mesh, box_mesh

WHEEL_SIDES = 12
TYRE_WIDTH_M = 0.21
TYRE = (0.018, 0.018, 0.019)
RIM, RIM_GAP = (0.42, 0.43, 0.44), (0.03, 0.03, 0.03)
PLATE_SIZE_M = (0.52, 0.11)


def detail_meshes(spec: CarSpec) -> list[Mesh]:
    profile = Profile(spec)
    meshes = [_wheel(profile, axle, side) for axle in (profile.front_axle, profile.rear_axle) for side in (1, -1)]
    meshes += [_mirror(spec, profile, side) for side in (1, -1)]
    meshes += [_plate(profile, end) for end in (1, -1)]
    gaps = [x * spec.length for x in profile.shape.side_gap_x]
    return meshes + [_shut_line(profile, x, side) for x in gaps for side in (1, -1)]


def _wheel(profile: Profile, axle_x: float, side: int) -> Mesh:
    """Tyre with a rounded shoulder, a dished rim with spokes; the outer face looks to ``side``."""
    angle = 2 * np.pi * (np.arange(WHEEL_SIDES) + 0.5) / WHEEL_SIDES
    radii = profile.radius * np.array([0.9, 1.0, 0.95, 0.70, 0.64, 0.0])
    outer = profile.half * 0.985
    y = outer - np.array([TYRE_WIDTH_M, 0.03, 0.0, 0.004, 0.03, 0.015])
    rings = [
        np.stack([axle_x + r * np.cos(angle), 0 * angle + side * v, profile.radius + r * np.sin(angle)], -1)
        for r, v in zip(radii, y, strict=True)
    ]
    faces = grid_faces(len(rings), WHEEL_SIDES, closed=True)
    faces = faces if side < 0 else faces[:, ::-1]
    colors = np.empty((len(rings) - 1, WHEEL_SIDES, 3), np.float32)
    colors[:], colors[3] = TYRE, RIM
    colors[4] = np.where((np.arange(WHEEL_SIDES) % 2 == 0)[:, None], np.array(RIM), np.array(RIM_GAP))
    materials = np.full((len(rings) - 1, WHEEL_SIDES), Material.RUBBER, np.uint8)
    materials[3:] = Material.METAL
    return painted(
        np.concatenate(rings), faces, np.repeat(colors.reshape(-1, 3), 2, 0), np.repeat(materials.ravel(), 2)
    )


def _mirror(spec: CarSpec, profile: Profile, side: int) -> Mesh:
    x = profile.cowl - 0.06 * profile.length * (1.0 if spec.body != "van" else 0.5)
    z = float(profile.shoulder(np.array([x]))[0]) + 0.07
    inner, outer = profile.half * 0.88, spec.width / 2
    tall = 0.14 if spec.body != "van" else 0.26
    size = (0.10, outer - inner, tall)
    color = spec.color if spec.body != "van" else DARK
    return box_mesh(size, (x, side * (inner + outer) / 2, z + tall / 4), color, Material.PAINT)


def _plate(profile: Profile, end: int) -> Mesh:
    x, y, z = end * profile.length / 2 + end * 0.012, PLATE_SIZE_M[0] / 2 * end, 0.28 * profile.height**0.5 * 1.25
    low, high = z - PLATE_SIZE_M[1] / 2, z + PLATE_SIZE_M[1] / 2
    return quad((x, -y, low), (x, y, low), (x, y, high), (x, -y, high), (0.62, 0.62, 0.58), Material.RETROREFLECTOR)


def _shut_line(profile: Profile, x: float, side: int) -> Mesh:
    """A dark line 12 mm wide from the sill to the belt, a hair outside the body's side."""
    at = np.array([x])
    w = float(profile.half_width(at)[0]) + 0.008
    lip, top = float(profile.arch(at)[0]), float(profile.shoulder(at)[0])
    rise = top - lip
    z = np.array([lip + 0.02, lip + 0.3 * rise, lip + 0.68 * rise, top - 0.05])
    y = side * w * np.array([0.977, 0.998, 1.0, 0.965])
    grid = np.stack([np.stack([np.full(4, x + d), y, z], -1) for d in (-0.006, 0.006)])
    faces = grid_faces(2, 4, closed=False)
    return painted(grid.reshape(-1, 3), faces if side > 0 else faces[:, ::-1], DARK, Material.RUBBER)
