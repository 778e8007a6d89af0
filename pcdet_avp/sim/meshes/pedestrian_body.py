"""The limbs a person is made of: round lofts on bones, built once per person.

A bone's frame has its origin in the joint, x forward and z up when the person stands straight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcdet_avp.sim.meshes.loft import grid_faces, painted
from pcdet_avp.sim.meshes.mesh import Material, Mesh
from pcdet_avp.sim.meshes.pedestrian_spec import PedestrianSpec

# Bone -> the bone it hangs on; parents come first.
_LIMBS = {"upper_arm": "torso", "forearm": "upper_arm", "thigh": None, "shin": "thigh", "foot": "shin"}
BONES: dict[str, str | None] = {"torso": None, "head": "torso"}
for _side in ("left", "right"):
    BONES |= {f"{_side}_{b}": f"{_side}_{p}" if p in _LIMBS else p for b, p in _LIMBS.items()}
# Lengths as shares of the body height: adult, child.
HEAD = {"adult": 0.135, "child": 0.165}
LEG = {"adult": 0.50, "child": 0.47}  # hip joint above the floor
SHOULDER_HALF = {"adult": 0.108, "child": 0.105}


@dataclass(frozen=True, eq=False)
class PedestrianBody:
    """vertices (V, 3) in their bones' frames, vertex_bone (V,), faces (F, 3), face_bone (F,), colors (F, 3),
    materials (F,), normals (F, 3, 3), and joints (B, 3): each bone's origin in its parent's frame."""

    vertices: np.ndarray
    vertex_bone: np.ndarray
    faces: np.ndarray
    face_bone: np.ndarray
    colors: np.ndarray
    materials: np.ndarray
    normals: np.ndarray
    joints: np.ndarray


def pedestrian_body(spec: PedestrianSpec) -> PedestrianBody:
    """All parts of one person."""
    parts = [*_trunk(spec), *_limbs(spec)]
    meshes, bones = [mesh for _, mesh in parts], [list(BONES).index(bone) for bone, _ in parts]
    whole = Mesh.merge(meshes)
    return PedestrianBody(
        whole.vertices.astype(np.float64),
        np.repeat(bones, [len(m.vertices) for m in meshes]),
        whole.faces,
        np.repeat(bones, [len(m.faces) for m in meshes]),
        whole.colors,
        whole.materials,
        whole.normals.astype(np.float64),
        _joints(spec),
    )


def _joints(spec: PedestrianSpec) -> np.ndarray:
    h, hip, half = spec.height, LEG[spec.kind] * spec.height, SHOULDER_HALF[spec.kind] * spec.height * spec.build
    top = (1 - HEAD[spec.kind]) * h - hip
    at = {"torso": (0, 0, hip), "head": (0, 0, top)}
    for side, y in (("left", 1), ("right", -1)):
        at[f"{side}_upper_arm"] = (0, y * half, top - 0.075 * h)
        at[f"{side}_forearm"] = (0, 0, -0.17 * h)
        at[f"{side}_thigh"] = (0, y * 0.052 * h * spec.build, hip)
        at[f"{side}_shin"] = (0, 0, -(hip - 0.04 * h) / 2)
        at[f"{side}_foot"] = (0, 0, -(hip - 0.04 * h) / 2)
    return np.array([at[bone] for bone in BONES], float)


def _loft(levels, sides: int, color, material: Material) -> Mesh:
    """Closed round body; levels are rows of (z, half depth x, half width y, centre x), bottom to top."""
    z, rx, ry, cx = np.array(levels, float).T
    angle = 2 * np.pi * np.arange(sides) / sides
    rings = np.stack(
        [
            cx[:, None] + rx[:, None] * np.cos(angle),
            ry[:, None] * np.sin(angle),
            np.repeat(z[:, None], sides, axis=1),
        ],
        -1,
    )
    rings = np.concatenate([_pole(rings[0]), rings, _pole(rings[-1])])
    return painted(rings.reshape(-1, 3), grid_faces(len(rings), sides, closed=True), color, material, crease=1.3)


def _pole(ring: np.ndarray) -> np.ndarray:
    return np.broadcast_to(ring.mean(0), (1, *ring.shape))


def _trunk(spec: PedestrianSpec) -> list[tuple[str, Mesh]]:
    h, b = spec.height, spec.build
    top = 1 - HEAD[spec.kind] - LEG[spec.kind]
    shoulder = SHOULDER_HALF[spec.kind]
    hips = [(-0.055, 0.03, 0.055, 0), (0.0, 0.060, 0.092, -0.004), (0.03, 0.060, 0.090, 0)]
    shirt = [
        (0.012, 0.066, 0.098, -0.002),
        (0.10, 0.060, 0.083, 0.004),
        (0.20, 0.070, 0.096, 0.006),
        (top - 0.085, 0.064, 0.97 * shoulder, 0),
        (top - 0.052, 0.052, 0.96 * shoulder, -0.004),
        (top - 0.022, 0.040, 0.60 * shoulder, -0.004),
        (top, 0.030, 0.033, 0.0),
    ]
    parts = [
        ("torso", _loft(_scaled(hips, h, b), 12, spec.bottom, Material.CLOTH)),
        ("torso", _loft(_scaled(shirt, h, b), 12, spec.top, Material.CLOTH)),
        ("head", _head(spec)),
        ("head", _hair(spec)),
    ]
    return parts + ([("torso", _backpack(spec, top))] if spec.backpack else [])


def _scaled(levels, length: float, girth: float = 1.0) -> list[tuple[float, float, float, float]]:
    """Levels in metres from levels in units of ``length``; only the cross section grows with ``girth``."""
    return [(z * length, x * length * girth, y * length * girth, c * length) for z, x, y, c in levels]


def _head(spec: PedestrianSpec) -> Mesh:
    levels = [
        (-0.25, 0.24, 0.25, -0.02),
        (0.0, 0.25, 0.25, 0.0),
        (0.08, 0.34, 0.27, 0.10),
        (0.28, 0.43, 0.34, 0.06),
        (0.5, 0.46, 0.38, 0.02),
        (0.75, 0.42, 0.36, 0.0),
        (0.92, 0.25, 0.22, 0.0),
    ]
    return _loft(_scaled(levels, HEAD[spec.kind] * spec.height), 10, spec.skin, Material.SKIN)


def _hair(spec: PedestrianSpec) -> Mesh:
    long, short = [(-0.12, 0.20, 0.34, -0.30), (0.2, 0.30, 0.41, -0.20)], [(0.30, 0.28, 0.36, -0.17)]
    crown = [(0.5, 0.40, 0.415, -0.09), (0.66, 0.47, 0.41, -0.03), (0.85, 0.40, 0.34, -0.02), (1.0, 0.16, 0.14, -0.02)]
    levels = _scaled((long if spec.long_hair else short) + crown, HEAD[spec.kind] * spec.height)
    return _loft(levels, 10, spec.hair, Material.CLOTH)


def _backpack(spec: PedestrianSpec, top: float) -> Mesh:
    levels = [
        (top - 0.27, 0.04, 0.07, -0.105),
        (top - 0.24, 0.055, 0.085, -0.105),
        (top - 0.12, 0.055, 0.085, -0.10),
        (top - 0.06, 0.03, 0.06, -0.085),
    ]
    color = tuple(0.6 * c + 0.02 for c in reversed(spec.top))
    return _loft(_scaled(levels, spec.height), 8, color, Material.CLOTH)


def _limbs(spec: PedestrianSpec) -> list[tuple[str, Mesh]]:
    h, b = spec.height, spec.build
    leg = (LEG[spec.kind] - 0.04) * h / 2
    sleeve = (spec.top, Material.CLOTH) if spec.long_sleeves else (spec.skin, Material.SKIN)
    trouser = (spec.bottom, Material.CLOTH) if spec.long_trousers else (spec.skin, Material.SKIN)
    cloth = Material.CLOTH
    loose = 1.12 if spec.long_trousers else 0.9
    parts = {
        "upper_arm": [_tube(-0.17 * h, 0.0, (0.025 * h * b, 0.029 * h * b, 0.033 * h * b), 8, spec.top, cloth)],
        "forearm": [_tube(-0.135 * h, 0.0, (0.019 * h * b, 0.024 * h * b, 0.027 * h * b), 8, *sleeve), _hand(spec)],
        "thigh": [_tube(-leg, 0.0, (0.037 * h * b, 0.048 * h * b, 0.057 * h * b), 8, spec.bottom, cloth)],
        "shin": [_tube(-leg, 0.0, (0.025 * h * b * loose, 0.032 * h * b * loose, 0.037 * h * b), 8, *trouser)],
        "foot": [_shoe(spec)],
    }
    return [(f"{side}_{bone}", mesh) for side in ("left", "right") for bone, meshes in parts.items() for mesh in meshes]


def _tube(low: float, high: float, radii: tuple[float, float, float], sides: int, color, material) -> Mesh:
    """A limb with rounded ends: thin end, middle and thick end radius, from bottom to top."""
    thin, middle, thick = radii
    levels = [(low - 0.5 * thin, 0.6 * thin), (low, thin), ((low + high) / 2, middle), (high, thick)]
    levels += [(high + 0.55 * thick, 0.75 * thick), (high + 0.9 * thick, 0.35 * thick)]
    return _loft([(z, r, r, 0.0) for z, r in levels], sides, color, material)


def _hand(spec: PedestrianSpec) -> Mesh:
    levels = [(-0.205, 0.012, 0.007, 0.006), (-0.17, 0.025, 0.013, 0.004), (-0.135, 0.016, 0.013, 0.0)]
    return _loft(_scaled(levels, spec.height), 6, spec.skin, Material.SKIN)


def _shoe(spec: PedestrianSpec) -> Mesh:
    levels = [
        (-0.04, 0.066, 0.024, 0.034),
        (-0.022, 0.068, 0.026, 0.034),
        (-0.008, 0.045, 0.024, 0.016),
        (0.012, 0.026, 0.022, 0.0),
    ]
    return _loft(_scaled(levels, spec.height), 8, spec.shoes, Material.RUBBER)
