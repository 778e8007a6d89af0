"""One simultaneous capture of both agents, with its ground truth: what travels between all parts of the package.

The simulator makes a ``Frame``, a record on disk holds one, the network's input is prepared from one.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from pcdet_avp.errors import GeometryError
from pcdet_avp.structures.boxes import check_boxes
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.lidar_scan import LidarScan
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SOURCES

CLASS_NAMES = ("Car", "Pedestrian")
DIFFICULTIES = ("easy", "hard", "invisible")
# Fewest visible box vertices of an easy and of a hard object: easy 5-8, hard 2-4, invisible 0-1 (ours: the paper
# gives no counts).
EASY_VERTICES, HARD_VERTICES = 5, 2


@dataclass(frozen=True, eq=False)
class AgentView:
    """Pose and sensor data of one agent, all in the agent's own frame; a sensor that did not capture is None.

    image: (H, W, 3) uint8 RGB. depth: (H, W) float32 metres along the optical axis, 0 = nothing there.
    points: (P, 4) float32 x, y, z, intensity in [0, 1]. scan: the range image the points came from, if any.
    """

    world_from_agent: Pose
    camera: PinholeCamera | None = None
    image: np.ndarray | None = None
    depth: np.ndarray | None = None
    points: np.ndarray | None = None
    scan: LidarScan | None = None


@dataclass(frozen=True, eq=False)
class Labels:
    """Every road user of the scene but the ego, hidden or not, in the ego frame.

    boxes (N, 7); names (N,) of ``CLASS_NAMES``; object_ids (N,) int, constant over a scene.
    visible_vertices (N,): box vertices in the vehicle camera's line of sight, 0-8.
    hit_counts (N, 4) int, in the order of ``SOURCES``: camera pixels or LiDAR points on the object.
    """

    boxes: np.ndarray
    names: np.ndarray
    object_ids: np.ndarray
    visible_vertices: np.ndarray
    hit_counts: np.ndarray

    def __post_init__(self) -> None:
        check_boxes(self.boxes, "labels.boxes")
        n = len(self.boxes)
        for name in ("names", "object_ids", "visible_vertices", "hit_counts"):
            if len(getattr(self, name)) != n:
                raise GeometryError(f"labels.{name}: expected {n} rows, found {len(getattr(self, name))}")
        if self.hit_counts.shape != (n, len(SOURCES)):
            expected = (n, len(SOURCES))
            raise GeometryError(f"labels.hit_counts: expected shape {expected}, found {self.hit_counts.shape}")
        unknown = set(self.names) - set(CLASS_NAMES)
        if unknown:
            raise GeometryError(f"labels.names: unknown classes {sorted(unknown)}; known: {CLASS_NAMES}")

    def __len__(self) -> int:
        return len(self.boxes)

    @property
    def difficulty(self) -> np.ndarray:
        """(N,) int index into ``DIFFICULTIES``, from the number of visible vertices."""
        return np.where(
            self.visible_vertices >= EASY_VERTICES, 0, np.where(self.visible_vertices >= HARD_VERTICES, 1, 2)
        )

    def select(self, mask: np.ndarray) -> Labels:
        """The rows where mask (N,) is true."""
        return Labels(*(getattr(self, f.name)[mask] for f in fields(self)))

    @classmethod
    def empty(cls) -> Labels:
        none = np.zeros(0, dtype=np.int64)
        return cls(np.zeros((0, 7)), np.zeros(0, dtype="<U10"), none, none, np.zeros((0, len(SOURCES)), dtype=np.int64))


@dataclass(frozen=True, eq=False)
class Frame:
    """A tick of the world: what the vehicle (ego) and the roadside mast (infra) captured, and the truth."""

    frame_id: str  # "scene/frame", unique in a data set
    time_s: float
    ego: AgentView
    infra: AgentView
    labels: Labels = field(default_factory=Labels.empty)

    @property
    def ego_from_infra(self) -> Pose:
        return self.ego.world_from_agent.inverse() @ self.infra.world_from_agent
