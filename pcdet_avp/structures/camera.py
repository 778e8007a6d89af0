"""Pin-hole camera with square pixels.

Camera frame: x right, y down, z along the optical axis. Image coordinates (u, v) are continuous:
the pixel in column c and row r covers [c, c+1) x [r, r+1) and its centre is (c + 0.5, r + 0.5).
Depth is the z coordinate in the camera frame (not the length of the ray), metres, as in CARLA and CaDDN.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcdet_avp.errors import GeometryError
from pcdet_avp.structures.pose import Pose

# Columns are the camera's axes in an agent frame that it faces along: right = -y, down = -z, forward = x.
AGENT_FROM_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True, eq=False)
class PinholeCamera:
    """Intrinsics in pixels and the extrinsic pose in the frame of the agent that carries the camera."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    agent_from_camera: Pose

    def __post_init__(self) -> None:
        if self.width <= 0 or self.height <= 0:
            raise GeometryError(f"camera: image size must be positive, found {self.width} x {self.height}")
        if not np.isfinite([self.fx, self.fy, self.cx, self.cy]).all() or self.fx <= 0 or self.fy <= 0:
            raise GeometryError(f"camera: bad intrinsics fx {self.fx} fy {self.fy} cx {self.cx} cy {self.cy}")

    @classmethod
    def looking_ahead(
        cls, width: int, height: int, hfov: float, x_m: float, z_m: float, pitch_down: float = 0.0
    ) -> PinholeCamera:
        """Square pixels, horizontal field of view ``hfov`` (radians), mounted at (x, 0, z) along the agent's x axis.

        The paper's 960 x 540 at 90 degrees gives fx = fy = 480 px and a vertical field of view of 58.7 degrees.
        """
        f = width / 2 / np.tan(hfov / 2)
        optical = np.eye(4)
        optical[:3, :3] = AGENT_FROM_OPTICAL
        mount = Pose.from_xyz_yaw(x_m, 0.0, z_m, pitch_down=pitch_down)
        return cls(width, height, f, f, width / 2, height / 2, mount @ Pose(optical))

    @property
    def intrinsics(self) -> np.ndarray:
        """K (3, 3), pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Image coordinates (..., 2) and depth (...,) of points (..., 3) in the agent frame.

        Points at or behind the camera plane have depth <= 0; their image coordinates are NaN.
        """
        p = self.agent_from_camera.inverse().apply(np.asarray(points, dtype=np.float64))
        depth = p[..., 2]
        safe = np.where(depth > 0, depth, np.nan)
        return np.stack([self.fx * p[..., 0] / safe + self.cx, self.fy * p[..., 1] / safe + self.cy], -1), depth

    def sees(self, points: np.ndarray) -> np.ndarray:
        """Mask (...,) of points (..., 3) in the agent frame that project into the image."""
        uv, depth = self.project(points)
        with np.errstate(invalid="ignore"):
            inside = (uv >= 0) & (uv < [self.width, self.height])
        return inside.all(-1) & (depth > 0)

    def pixel_rays(self) -> np.ndarray:
        """(H, W, 3) float32 camera-frame rays through the pixel centres, with z = 1: depth is the ray parameter."""
        u = (np.arange(self.width, dtype=np.float32) + 0.5 - self.cx) / self.fx
        v = (np.arange(self.height, dtype=np.float32) + 0.5 - self.cy) / self.fy
        rays = np.ones((self.height, self.width, 3), dtype=np.float32)
        rays[..., 0], rays[..., 1] = u[None, :], v[:, None]
        return rays

    def scaled(self, width: int, height: int) -> PinholeCamera:
        """The same camera after its image was resized to width x height."""
        sx, sy = width / self.width, height / self.height
        return PinholeCamera(
            width, height, self.fx * sx, self.fy * sy, self.cx * sx, self.cy * sy, self.agent_from_camera
        )
