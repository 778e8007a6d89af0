"""Rigid transforms, named ``dst_from_src`` so that compositions read themselves.

``ego_from_infra = world_from_ego.inverse() @ world_from_infra``
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcdet_avp.errors import GeometryError

EXACT = 1e-9  # what rounding of float64 explains: such a rotation stays bit by bit
ROUNDED = 1e-4  # what writing four decimals or float32 explains


@dataclass(frozen=True, eq=False)
class Pose:
    """A rotation and a translation in metres: p_dst = R p_src + t, held as a (4, 4) float64 matrix.

    A rotation that was rounded, no entry farther than ``ROUNDED`` from the nearest true one, becomes that one;
    GeometryError where it is farther away, mirrored, not finite or of another shape.
    """

    matrix: np.ndarray

    def __post_init__(self) -> None:
        matrix = np.array(self.matrix, dtype=np.float64)
        if matrix.shape != (4, 4):
            raise GeometryError(f"pose: expected a (4, 4) matrix, found shape {matrix.shape}")
        if not np.isfinite(matrix).all():
            raise GeometryError("pose: matrix holds NaN or infinite values")
        if np.abs(matrix[3] - [0, 0, 0, 1]).max() > ROUNDED:
            raise GeometryError(f"pose: last row must be 0 0 0 1, found {matrix[3].tolist()}")
        matrix[3] = 0, 0, 0, 1
        matrix[:3, :3] = _rotation(matrix[:3, :3])
        matrix.setflags(write=False)
        object.__setattr__(self, "matrix", matrix)

    @classmethod
    def identity(cls) -> Pose:
        return cls(np.eye(4))

    @classmethod
    def from_xyz_yaw(cls, x: float, y: float, z: float = 0.0, yaw: float = 0.0, pitch_down: float = 0.0) -> Pose:
        """Position in metres; yaw counter-clockwise about z, then pitch about the new y axis (nose down), radians."""
        cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch_down), np.sin(pitch_down)
        rows = [[cy * cp, -sy, cy * sp, x], [sy * cp, cy, sy * sp, y], [-sp, 0.0, cp, z], [0.0, 0.0, 0.0, 1.0]]
        return cls._known(np.array(rows, dtype=np.float64))

    @classmethod
    def _known(cls, matrix: np.ndarray) -> Pose:
        """Of a fresh matrix whose rotation is one by construction: looked at only for NaN."""
        if not np.isfinite(matrix).all():
            return cls(matrix)  # raises
        pose = object.__new__(cls)
        matrix.setflags(write=False)
        object.__setattr__(pose, "matrix", matrix)
        return pose

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3)."""
        return self.matrix[:3, :3]

    @property
    def translation(self) -> np.ndarray:
        """(3,) metres."""
        return self.matrix[:3, 3]

    @property
    def yaw(self) -> float:
        """Heading of the source's x axis in the destination's horizontal plane, radians in (-pi, pi]."""
        return float(np.arctan2(self.matrix[1, 0], self.matrix[0, 0]))

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Transform points (..., 3); the result has their floating type (float64 for integers)."""
        points = np.asarray(points)
        dtype = points.dtype if points.dtype.kind == "f" else np.float64
        return points @ self.rotation.T.astype(dtype) + self.translation.astype(dtype)

    def inverse(self) -> Pose:
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation.T
        matrix[:3, 3] = -self.rotation.T @ self.translation
        return Pose._known(matrix)

    def __matmul__(self, other: Pose) -> Pose:
        """a_from_b @ b_from_c is a_from_c."""
        return Pose._known(self.matrix @ other.matrix)  # what rounding does to it stays far below EXACT


def _rotation(block: np.ndarray) -> np.ndarray:
    """The nearest rotation to a (3, 3) block; the block itself where that is what it is."""
    determinant = np.linalg.det(block)
    if np.abs(block @ block.T - np.eye(3)).max() <= EXACT and determinant > 0:
        return block
    if determinant < 0:
        raise GeometryError(
            f"pose: upper left 3 x 3 block is not a rotation: it mirrors (determinant {determinant:.4g}); "
            "left-handed axes have to be turned into right-handed ones, y -> -y, on both sides"
        )
    left, _, right = np.linalg.svd(block)
    nearest = left @ right
    off = float(np.abs(block - nearest).max())
    if off > ROUNDED:
        raise GeometryError(
            f"pose: upper left 3 x 3 block is not a rotation: entries differ by up to {off:.2g} from the nearest one, "
            f"rounding explains {ROUNDED:g}; write more decimals, take out scale and shear"
        )
    return nearest
