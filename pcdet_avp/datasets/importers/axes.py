"""Frames: the others' axes, angles, sizes and calibration -> ours. Nothing else in this package converts any of them.

Ours        metres, radians; right-handed, x forward, y left, z up; headings counter-clockwise from +x; full box sizes.
Unreal      (CARLA, OPV2V) metres, degrees; left-handed, x forward, y RIGHT, z up. Yaw turns x towards y (clockwise seen
            from above), pitch lifts the nose, roll lifts the left side. Sizes are half sizes ("extent"). Sensors,
            cameras included, look along their x axis.
Optical     a camera's frame in ours, in KITTI and in DAIR-V2X: x right, y down, z along the optical axis.
DAIR-V2X    world, novatel and LiDAR frames are right-handed with z up; a rotation and a translation lead from one to
            the next.

With ``M = diag(1, -1, 1)``, which mirrors y, a left-handed rotation ``R`` and point ``p`` become ``M R M`` and ``M p``:
the yaw and the pitch change their signs, the roll does not.

An agent of ours stands upright on the floor: ``upright`` keeps x, y and the yaw of a pose, and sets z to the floor's.
What the sensor is tilted and lifted against it goes into ``agent_from_sensor``.
Sources: carla.Transform of CARLA 0.9.16's Python package, tried with its ``get_matrix``; OpenCOOD's
``transformation_utils.py`` and ``box_utils.py``; DAIR-V2X's ``transformation_utils.py``. The formulas are written anew.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import rq
from scipy.spatial.transform import Rotation

from pcdet_avp.errors import GeometryError
from pcdet_avp.structures.camera import AGENT_FROM_OPTICAL, PinholeCamera
from pcdet_avp.structures.pose import ROUNDED, Pose

Numbers = Sequence[float] | np.ndarray

MIRROR_Y = np.array([1.0, -1.0, 1.0])
SMALLEST_SIZE_M = 0.01  # a box that is thinner has no size: CARLA and DAIR-V2X list some of 0
LARGEST_SIZE_M = 60.0  # longer than any road vehicle: centimetres, most likely
# A calibration that is no rotation is replaced by the nearest one if no entry differs by more: 1 cm at 1 m.
REPAIRED = 0.01
SHEARED = 0.25  # the same of a camera's, whose effect on the pixels is kept; one of DAIR-V2X's is off by 0.18
MAX_SKEW = 0.01  # of the image's width, at its upper and lower edge: what a pin-hole without skew may lose

OPTICAL = np.eye(4)
OPTICAL[:3, :3] = AGENT_FROM_OPTICAL


def pose_from_unreal(location: Numbers, roll_deg: float, pitch_deg: float, yaw_deg: float) -> Pose:
    """``world_from_x`` in our axes, of a location (3,) in metres and a rotation in degrees, both Unreal's."""
    matrix = np.eye(4)
    turns = Rotation.from_euler("ZYX", [-yaw_deg, -pitch_deg, roll_deg], degrees=True)
    matrix[:3, :3], matrix[:3, 3] = turns.as_matrix(), points_from_unreal(location)
    return Pose(matrix)


def points_from_unreal(points: Numbers) -> np.ndarray:
    """Points (..., 3) of a left-handed frame in the same frame with y to the left."""
    return np.asarray(points, dtype=np.float64) * MIRROR_Y


def cloud_in_agent(agent_from_lidar: Pose, points: np.ndarray) -> np.ndarray:
    """(P, 4) float32 x, y, z, intensity of a right-handed LiDAR frame, in the agent's."""
    moved = agent_from_lidar.apply(points[:, :3].astype(np.float64))
    return np.concatenate([moved, points[:, 3:4]], 1).astype(np.float32)


def upright(world_from_x: Pose, floor_z: float) -> Pose:
    """``world_from_agent`` of the agent whose mast, or vehicle, the pose is of; the tilt is left to the sensors."""
    x, y, _ = world_from_x.translation
    return Pose.from_xyz_yaw(x, y, floor_z, world_from_x.yaw)


def unreal_camera(agent_from_sensor: Pose, width: int, height: int, intrinsics: np.ndarray) -> PinholeCamera:
    """A camera that looks along the x axis of its sensor frame; ``intrinsics`` K (3, 3) in pixels.

    GeometryError where K has a skew, or is none.
    """
    _refuse_skew(intrinsics)
    return _camera(width, height, intrinsics, agent_from_sensor @ Pose(OPTICAL))


def unreal_box(world_from_actor: Pose, centre: Numbers, extent: Numbers) -> np.ndarray | None:
    """(7,) in our world: ``centre`` (3,) in the actor's own left-handed frame, ``extent`` (3,) half sizes; metres.

    None where the box has no size, GeometryError where none can be meant. Its pitch and roll are left out: our boxes
    stand upright.
    """
    return box_of(world_from_actor.apply(points_from_unreal(centre)), 2.0 * np.asarray(extent), world_from_actor.yaw)


def corner_box(corners: np.ndarray) -> np.ndarray | None:
    """(7,) of eight vertices (8, 3) in a right-handed frame; None where the box has no size.

    Their order is that of DAIR-V2X's ``world_8_points``: front left, front right, rear right, rear left, and the same
    again above.
    """
    front, left = corners[[0, 1, 4, 5]].mean(0) - corners[[2, 3, 6, 7]].mean(0), corners[[0, 3, 4, 7]].mean(0)
    left, up = left - corners[[1, 2, 5, 6]].mean(0), corners[4:].mean(0) - corners[:4].mean(0)
    sizes = np.linalg.norm([front, left, up], axis=1)
    if front[0] * left[1] - front[1] * left[0] < 0 or up[2] < 0:
        raise GeometryError("the eight vertices are not in the expected order, or in left-handed axes")
    return box_of(corners.mean(0), sizes, float(np.arctan2(front[1], front[0])))


def box_of(centre: np.ndarray, sizes: np.ndarray, heading: float) -> np.ndarray | None:
    """(7,), or None where a size is below ``SMALLEST_SIZE_M``; GeometryError where one is negative or no car's."""
    if np.min(sizes) < 0 or np.max(sizes) > LARGEST_SIZE_M:
        raise GeometryError(
            f"box: expected sizes in metres, from 0 to {LARGEST_SIZE_M:g}, found {' x '.join(f'{s:g}' for s in sizes)}"
        )
    return None if np.min(sizes) < SMALLEST_SIZE_M else np.array([*centre, *sizes, heading])


def repaired_pose(rotation: np.ndarray, translation: np.ndarray) -> tuple[Pose, float]:
    """The pose of a rotation (3, 3) that a calibration may have sheared, and by how much it was repaired.

    The nearest rotation is taken where no entry differs by more than ``REPAIRED``; the difference is 0 where rounding
    explains it. GeometryError beyond.
    """
    nearest, off = _nearest(rotation)
    _refuse_beyond(rotation, off, REPAIRED)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = nearest, np.ravel(translation)
    return Pose(matrix), off if off > ROUNDED else 0.0


def pinhole(
    width: int, height: int, intrinsics: np.ndarray, rotation: np.ndarray, translation: np.ndarray
) -> tuple[PinholeCamera, float]:
    """A camera in the frame of the points that ``rotation`` (3, 3) and ``translation`` (3,) lead to its optical frame.

    If the rotation is none, the pixel ``K (R p + t)`` of every point is kept by other intrinsics: ``K R`` is parted
    anew into an upper triangle and a rotation. Only the triangle's skew is lost, and the second value says how many
    pixels that moves a point at the image's upper or lower edge. GeometryError if it is more than ``MAX_SKEW`` of the
    width, if an entry of ``R`` differs by more than ``SHEARED`` from the nearest rotation, if ``R`` mirrors, or if
    ``intrinsics`` have a skew themselves.
    """
    _refuse_skew(intrinsics)
    skew_px, translation, (_, off) = 0.0, np.ravel(translation), _nearest(rotation)
    _refuse_beyond(rotation, off, SHEARED)
    if off > ROUNDED:
        intrinsics, rotation, translation, skew_px = _parted(intrinsics, rotation, translation, height)
    if skew_px > MAX_SKEW * width:
        raise GeometryError(f"shears the image by {skew_px:.1f} pixels, at most {MAX_SKEW * width:.1f} are left out")
    camera_from_agent = np.eye(4)
    camera_from_agent[:3, :3], camera_from_agent[:3, 3] = rotation, translation
    return _camera(width, height, intrinsics, Pose(camera_from_agent).inverse()), skew_px


def _camera(width: int, height: int, intrinsics: np.ndarray, agent_from_camera: Pose) -> PinholeCamera:
    fx, fy, cx, cy = intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2]
    return PinholeCamera(width, height, fx, fy, cx, cy, agent_from_camera)


def _refuse_skew(intrinsics: np.ndarray) -> None:
    """GeometryError where K is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]: the other entries would be lost."""
    others = intrinsics * [[0, 1, 0], [1, 0, 0], [1, 1, 1]] - np.diag([0.0, 0.0, 1.0])
    if np.abs(others).max() > ROUNDED:
        found = ", ".join(str([float(f"{entry:g}") for entry in row]) for row in intrinsics)
        raise GeometryError(f"intrinsics: expected [fx, 0, cx], [0, fy, cy], [0, 0, 1], found {found}")


def _nearest(block: np.ndarray) -> tuple[np.ndarray, float]:
    """The nearest rotation to a (3, 3) block, and the largest difference of an entry."""
    left, _, right = np.linalg.svd(block)
    return left @ right, float(np.abs(block - left @ right).max())


def _refuse_beyond(rotation: np.ndarray, off: float, limit: float) -> None:
    if np.linalg.det(rotation) <= 0:
        raise GeometryError("rotation: mirrors, or flattens; expected a rotation in right-handed axes")
    if off > limit:
        raise GeometryError(
            f"rotation: scales or shears; its entries differ by up to {off:.2g} from the nearest rotation, "
            f"at most {limit:g} is repaired"
        )


def _parted(intrinsics: np.ndarray, block: np.ndarray, translation: np.ndarray, height: int):
    """K', R', t', skew: K' (R' p + t') is K (block p + t) up to scale, K' an upper triangle; its skew in pixels."""
    triangle, rotation = rq(intrinsics @ block)
    signs = np.diag(np.sign(np.diag(triangle)))
    triangle, rotation = triangle @ signs, signs @ rotation
    moved = np.linalg.solve(triangle, intrinsics @ translation)
    triangle = triangle / triangle[2, 2]
    edge = max(triangle[1, 2], height - triangle[1, 2]) / triangle[1, 1]
    return triangle, rotation, moved, float(abs(triangle[0, 1]) * edge)
