"""What is bolted to a car's body: wheels, mirrors, number plates, shut lines, door handles."""

from __future__ import annotations

import numpy as np

from pcdet_avp.sim.meshes.car_body import DARK, Profile
from pcdet_avp.sim.meshes.car_spec import CarSpec
from pcdet_avp.sim.meshes.loft import grid_faces, painted_all, quad
from pcdet_avp.sim.meshes.mesh import Material, Mesh, box_mesh

WHEEL_SIDES = 12
TYRE_WIDTH_M = 0.21
TYRE = (0.018, 0.018, 0.019)
RING_RADII = np.array([0.9, 1.0, 0.95, 0.70, 0.64, 0.0])  # of the wheel's, from the inside out
RING_DEPTHS_M = np.array([TYRE_WIDTH_M, 0.03, 0.0, 0.004, 0.03, 0.015])  # behind the wheel's outer plane
RIM, RIM_GAP = (0.42, 0.43, 0.44), (0.03, 0.03, 0.03)
PLATE_SIZE_M = (0.52, 0.11)


def detail_meshes(spec: CarSpec) -> list[Mesh]:
    profile = Profile(spec)
    meshes = [_wheels(profile), *(_mirror(spec, profile, side) for side in (1, -1))]
    return [*meshes, *(_plate(profile, end) for end in (1, -1)), _shut_lines(profile)]


def _wheels(profile: Profile) -> Mesh:
    """Tyres with a rounded shoulder, dished rims with spokes; the outer faces look outwards."""
    axles = np.repeat([profile.front_axle, profile.rear_axle], 2)
    y = profile.half * 0.985 - RING_DEPTHS_M
    radii = (profile.radius * RING_RADII)[:, None]
    vertices = np.empty((4, len(RING_RADII), WHEEL_SIDES, 3))
    vertices[..., 0] = axles[:, None, None] + radii * WHEEL_COS
    vertices[..., 1] = SIDES[:, None, None] * y[:, None]
    vertices[..., 2] = profile.radius + radii * WHEEL_SIN
    return painted_all(vertices.reshape(4, -1, 3), WHEEL_FACES, *WHEEL_LOOKS)


def _wheel_looks() -> tuple[np.ndarray, np.ndarray]:
    """Colours (F, 3) and materials (F,) of a wheel's faces."""
    colors = np.empty((len(RING_RADII) - 1, WHEEL_SIDES, 3), np.float32)
    colors[:], colors[3] = TYRE, RIM
    colors[4] = np.where((np.arange(WHEEL_SIDES) % 2 == 0)[:, None], np.array(RIM), np.array(RIM_GAP))
    materials = np.full((len(RING_RADII) - 1, WHEEL_SIDES), Material.RUBBER, np.uint8)
    materials[3:] = Material.METAL
    return np.repeat(colors.reshape(-1, 3), 2, 0), np.repeat(materials.ravel(), 2)


def _on_both_sides(faces: np.ndarray, turned: int) -> np.ndarray:
    """(4, F, 3) faces of front left, front right, rear left, rear right; on side ``turned`` the other way round."""
    return np.stack([faces[:, ::-1] if side == turned else faces for side in SIDES])


SIDES = np.array([1, -1, 1, -1])
WHEEL_ANGLES = 2 * np.pi * (np.arange(WHEEL_SIDES) + 0.5) / WHEEL_SIDES
WHEEL_COS, WHEEL_SIN = np.cos(WHEEL_ANGLES), np.sin(WHEEL_ANGLES)
WHEEL_FACES = _on_both_sides(grid_faces(len(RING_RADII), WHEEL_SIDES, closed=True), turned=1)
WHEEL_LOOKS = _wheel_looks()


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


def _shut_lines(profile: Profile) -> Mesh:
    """Dark lines 12 mm wide from the sill to the belt, a hair outside the body's sides."""
    grids = [_shut_line(profile, x * profile.length, side) for x in profile.shape.side_gap_x for side in (1, -1)]
    ahead = grid_faces(2, 4, closed=False)
    faces = np.stack([ahead, ahead[:, ::-1]] * len(profile.shape.side_gap_x))
    return painted_all(np.reshape(grids, (len(grids), -1, 3)), faces, DARK, Material.RUBBER)


def _shut_line(profile: Profile, x: float, side: int) -> np.ndarray:
    """(2, 4, 3) vertices."""
    at = np.array([x])
    w = float(profile.half_width(at)[0]) + 0.008
    lip, top = float(profile.arch(at)[0]), float(profile.shoulder(at)[0])
    rise = top - lip
    grid = np.empty((2, 4, 3))
    grid[..., 0] = x + np.array([[-0.006], [0.006]])
    grid[..., 1] = side * w * np.array([0.977, 0.998, 1.0, 0.965])
    grid[..., 2] = lip + 0.02, lip + 0.3 * rise, lip + 0.68 * rise, top - 0.05
    return grid
