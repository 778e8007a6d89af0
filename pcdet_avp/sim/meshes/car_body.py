"""A car's sheet metal and glass: two lofts of cross sections along x, the lower body and the greenhouse.

Stations run from the rear to the front. A half section is a list of points from the bottom centre to the top
centre on the left side (y > 0); the right side is its mirror image.
"""

from __future__ import annotations

import numpy as np

from pcdet_avp.sim.meshes.car_spec import BODY_SHAPES, CarSpec, axles_x
from pcdet_avp.sim.meshes.loft import grid_faces, mirrored_ring, painted
from pcdet_avp.sim.meshes.mesh import Material, Mesh

MIRROR_REACH_M = 0.05  # how far a mirror stands out from the body's side
ARCH_GAP_M = 0.05  # between tyre and wheel arch
CAP_BULGE_M = 0.008  # of the end walls' middle
DARK = (0.02, 0.02, 0.022)  # unpainted plastic, shut lines, grilles
GLASS = (0.02, 0.024, 0.026)


class Profile:
    """Side view and plan of one car, in metres."""

    def __init__(self, spec: CarSpec) -> None:
        shape, (bonnet, rake, belt, taper) = BODY_SHAPES[spec.body], spec.shape
        self.shape, self.length, self.height = shape, spec.length, spec.height
        self.half = spec.width / 2 - MIRROR_REACH_M
        self.radius = shape.wheel_radius_m * (1 + 0.03 * belt) * min(1.1, 0.5 + 0.5 * spec.height / 1.5)
        self.front_axle, self.rear_axle = axles_x(spec.length)
        self.cowl = (shape.cowl_x + 0.012 * bonnet) * spec.length
        self.screen_top = (shape.screen_top_x + 0.012 * bonnet + 0.015 * rake) * spec.length
        self.roof_end = (shape.roof_end_x + 0.01 * taper) * spec.length
        self.tail_glass = shape.tail_glass_x * spec.length
        self.belt_shift = 0.012 * belt * spec.height
        self.floor = 0.13 + 0.03 * spec.height
        self.roof_drop = (0.035 + 0.015 * taper) * spec.height

    def half_width(self, x: np.ndarray) -> np.ndarray:
        """Widest half width (m) of the body at x (n,), in m forward of the car's centre."""
        front = np.clip((x - (self.length / 2 - 1.0)) / 1.0, 0, 1) ** 2.6 * self.shape.front_taper
        rear = np.clip((-self.length / 2 + 0.8 - x) / 0.8, 0, 1) ** 2.6 * self.shape.rear_taper
        return self.half * (1 - front - rear)

    def shoulder(self, x: np.ndarray) -> np.ndarray:
        """Height of the belt, the bonnet's edge and the boot's edge (m above the floor) at x (n,) in m."""
        s, h, half = self.shape, self.height, self.length / 2
        belt = np.interp(x, [self.tail_glass, self.cowl], [s.deck_z * h, s.cowl_z * h - 0.03]) + self.belt_shift
        forward = np.clip((x - self.cowl) / (half - self.cowl), 0, 1)
        backward = np.clip((self.tail_glass - x) / max(half + self.tail_glass, 1e-3), 0, 1)
        belt = belt - (s.cowl_z - s.nose_z) * h * forward**1.7 - (s.deck_z - s.tail_z) * h * backward**2
        return belt - 0.07 * np.exp(-(half - np.abs(x)) / 0.10)

    def arch(self, x: np.ndarray) -> np.ndarray:
        """Height of the sill (m above the floor) at x (n,) in m, raised to the wheel arches' edge."""
        reach = self.radius + ARCH_GAP_M
        z = np.full_like(x, self.floor + 0.03)
        for axle in (self.front_axle, self.rear_axle):
            inside = np.abs(x - axle) < reach
            rise = np.sqrt(np.maximum(reach**2 - (x - axle) ** 2, 0))
            z = np.where(inside, np.maximum(z, self.radius + rise), z)
        return z

    def roof(self, x: np.ndarray) -> np.ndarray:
        """Height of the greenhouse's top (m above the floor) at x (n,) in m: rear window, roof, windscreen."""
        h = self.height
        at = [self.tail_glass, self.roof_end, self.roof_end * 0.5 + self.screen_top * 0.5, self.screen_top, self.cowl]
        up = [self.shape.deck_z * h, h - self.roof_drop, h, h - 0.035, self.shape.cowl_z * h - 0.01]
        return np.interp(x, at, up) + self.belt_shift * np.interp(x, [at[0], at[1], at[3], at[4]], [1, 0, 0, 1])


def body_mesh(spec: CarSpec) -> Mesh:
    """Lower body with wheel arches and end caps, and the greenhouse on top of it."""
    profile = Profile(spec)
    return Mesh.merge([_lower_body(spec, profile), _greenhouse(spec, profile)])


def _lower_stations(profile: Profile) -> np.ndarray:
    reach, half = profile.radius + ARCH_GAP_M, profile.length / 2
    arc = reach * np.array([-1.001, -0.999, -0.8, -0.35, 0.35, 0.8, 0.999, 1.001])
    ends = np.array([0.0, 0.05, 0.14, 0.32])
    middle = [profile.tail_glass + 0.02, profile.cowl - 0.02, profile.cowl + 0.15]
    x = np.concatenate([ends - half, half - ends, profile.front_axle + arc, profile.rear_axle + arc, middle])
    return np.unique(np.clip(x, -half, half).round(4))


def _lower_body(spec: CarSpec, profile: Profile) -> Mesh:
    x = _lower_stations(profile)
    half = _lower_sections(x, profile)
    ring = mirrored_ring(half)
    vertices, columns = ring.reshape(-1, 3), ring.shape[1]
    faces = grid_faces(len(x), columns, closed=True)
    colors, materials = _lower_paint(spec, profile, x, half.shape[1])
    sides = painted(vertices, faces, colors, materials)
    return Mesh.merge([sides, _cap(spec, half[-1], True), _cap(spec, half[0], False)])


def _lower_sections(x: np.ndarray, profile: Profile) -> np.ndarray:
    """(S, 9, 3) half sections."""
    w, top, lip = profile.half_width(x), profile.shoulder(x), profile.arch(x)
    end = np.exp(-(profile.length / 2 - np.abs(x)) / 0.03)  # 1 at the bumpers' outermost section
    w = w * (1 - 0.05 * end)
    lip = lip + 0.05 * end
    floor = np.minimum(profile.floor + 0.08 * end, lip)
    inner = w - 0.27
    crown = 0.035 * (1 - 0.5 * end)
    y = [0 * x, inner, 0.975 * w, 0.998 * w, w, 0.965 * w, 0.90 * w, 0.5 * w, 0 * x]
    rise = top - lip
    z = [floor, lip, lip, lip + 0.3 * rise, lip + 0.68 * rise, top - 0.05, top, top + crown, top + 1.3 * crown]
    return np.stack([np.stack([x, a, b], -1) for a, b in zip(y, z, strict=True)], axis=1)


def _lower_paint(spec: CarSpec, profile: Profile, x: np.ndarray, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Colours and materials of the loft's faces: underbody, sills, paint, lamps at the corners."""
    quads = 2 * rows - 2
    row = np.minimum(np.arange(quads), quads - 1 - np.arange(quads))
    middle = (x[:-1] + x[1:]) / 2
    colors = np.empty((len(middle), quads, 3), np.float32)
    colors[:] = spec.color
    materials = np.full((len(middle), quads), Material.PAINT, np.uint8)
    colors[:, row <= 1], materials[:, row <= 1] = DARK, Material.RUBBER
    if spec.body in ("suv", "van"):
        colors[:, row == 2] = np.array(DARK) if spec.body == "suv" else np.array(spec.color) * 0.6
    front, rear = middle > profile.length / 2 - 0.32, middle < -profile.length / 2 + 0.12
    for where, rows_lit, color, material in (
        (front, (4,), (0.55, 0.56, 0.58), Material.HEAD_LAMP),
        (rear, (3, 4), (0.30, 0.01, 0.01), Material.TAIL_LAMP),
    ):
        index = np.ix_(where, np.isin(row, rows_lit))
        colors[index], materials[index] = color, material
    return np.repeat(colors.reshape(-1, 3), 2, axis=0), np.repeat(materials.ravel(), 2)


def _cap(spec: CarSpec, half: np.ndarray, front: bool) -> Mesh:
    """The end wall: a ladder of rows from bottom to top, three quads wide."""
    share = np.array([1.0, 0.62, -0.62, -1.0] if front else [-1.0, -0.66, 0.66, 1.0])
    grid = np.repeat(half[1:, None], 4, axis=1) * np.stack([np.ones(4), share, np.ones(4)], -1)
    grid[1:-1, 1:-1, 0] += np.sign(half[0, 0]) * CAP_BULGE_M
    faces = grid_faces(len(grid), 4, closed=False)[:, ::-1]
    colors, materials = _cap_paint(spec, len(grid) - 1, front)
    return painted(grid.reshape(-1, 3), faces, colors, materials, crease=0.3)


def _cap_paint(spec: CarSpec, rows: int, front: bool) -> tuple[np.ndarray, np.ndarray]:
    colors = np.empty((rows, 3, 3), np.float32)
    colors[:] = spec.color
    materials = np.full((rows, 3), Material.PAINT, np.uint8)
    colors[:2], materials[:2] = DARK, Material.RUBBER
    if front:
        colors[3, 1], materials[3, 1] = DARK, Material.RUBBER
        colors[3, [0, 2]], materials[3, [0, 2]] = (0.55, 0.56, 0.58), Material.HEAD_LAMP
    else:
        colors[2:4, [0, 2]], materials[2:4, [0, 2]] = (0.30, 0.01, 0.01), Material.TAIL_LAMP
    return np.repeat(colors.reshape(-1, 3), 2, axis=0), np.repeat(materials.ravel(), 2)


def _greenhouse(spec: CarSpec, profile: Profile) -> Mesh:
    """Windscreen, side windows, pillars, roof and rear window; open below, where the body closes it."""
    x = _greenhouse_stations(profile)
    half = _greenhouse_sections(x, profile)
    full = np.concatenate([half, half[:, -2::-1] * np.array([1.0, -1.0, 1.0])], axis=1)
    faces = grid_faces(len(x), full.shape[1], closed=False)
    colors, materials = _greenhouse_paint(spec, profile, x, full.shape[1] - 1)
    return painted(full.reshape(-1, 3), faces, colors, materials, crease=0.55)


def _greenhouse_stations(profile: Profile) -> np.ndarray:
    rear, top, front, cowl = profile.tail_glass, profile.roof_end, profile.screen_top, profile.cowl
    pillar = profile.shape.side_gap_x[1] * profile.length
    end = profile.shape.glazed_to_x * profile.length
    x = [rear, rear * 0.9 + top * 0.1, rear * 0.2 + top * 0.8, top, (top + front) / 2]
    x += [
        pillar - 0.05,
        pillar + 0.05,
        end,
        rear + 0.85,
        front - 0.15,
        front,
        front * 0.85 + cowl * 0.15,
        front * 0.3 + cowl * 0.7,
        front * 0.08 + cowl * 0.92,
        cowl,
    ]
    return np.unique(np.array(x).round(4))


def _greenhouse_sections(x: np.ndarray, profile: Profile) -> np.ndarray:
    """(S, 7, 3) half sections from the belt to the roof's centre."""
    belt, top = profile.shoulder(x) - 0.02, profile.roof(x)
    foot = 0.93 * profile.half_width(x)
    tall = profile.height - profile.shape.deck_z * profile.height
    lean = profile.shape.tumblehome * profile.half * np.clip((top - belt) / tall, 0, 1)
    head = foot - lean
    rise = top - belt
    y = [foot, foot - 0.08 * lean, foot - 0.80 * lean, head, 0.88 * head, 0.45 * head, 0 * x]
    z = [belt, belt + 0.10 * rise, belt + 0.84 * rise, belt + 0.94 * rise, top - 0.012, top - 0.003, top]
    bow = 0.10 * np.clip((x - profile.screen_top) / (profile.cowl - profile.screen_top), 0, 1)
    forward = [-bow, -bow, -bow, -bow, -0.75 * bow, -0.2 * bow, 0 * x]
    return np.stack([np.stack([x + f, a, b], -1) for f, a, b in zip(forward, y, z, strict=True)], axis=1)


def _greenhouse_paint(spec: CarSpec, profile: Profile, x: np.ndarray, quads: int) -> tuple[np.ndarray, np.ndarray]:
    row = np.minimum(np.arange(quads), quads - 1 - np.arange(quads))
    middle = (x[:-1] + x[1:]) / 2
    glass = np.zeros((len(middle), quads), bool)
    pillar, end = profile.shape.side_gap_x[1] * profile.length, profile.shape.glazed_to_x * profile.length
    screen = (middle > profile.screen_top) & (middle < profile.cowl - 0.02)
    tail = (middle < profile.roof_end * 0.85 + profile.tail_glass * 0.15) & (middle > profile.tail_glass + 0.005)
    side = (middle > end) & (middle < profile.screen_top * 0.3 + profile.cowl * 0.7) & (np.abs(middle - pillar) > 0.05)
    glass[np.ix_(screen | tail, row >= 4)] = True
    glass[np.ix_(side, row == 1)] = True
    colors = np.where(glass[..., None], np.array(GLASS), np.array(spec.color)).astype(np.float32)
    materials = np.where(glass, Material.GLASS, Material.PAINT).astype(np.uint8)
    return np.repeat(colors.reshape(-1, 3), 2, axis=0), np.repeat(materials.ravel(), 2)
