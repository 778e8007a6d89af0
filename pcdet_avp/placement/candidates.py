"""Places where a roadside sensor may hang: those that a plan lists, and more, drawn where a building has something to
hang them from: the ceiling above lanes and beside them, pillars and walls.
"""

from __future__ import annotations

import numpy as np

from pcdet_avp.sim.plans.floor import Floor, Mount
from pcdet_avp.structures.rotated_iou import bev_intersection

BELOW_CEILING_M = 0.15
HIGHEST_M = 7.0  # the paper's
ALONG_M = 2.5  # ceiling places along a lane
APART_M = 1.0


def find_candidates(floor: Floor, count: int) -> tuple[Mount, ...]:
    """The plan's mounts, then generated ones, ``count`` in all or as many as there are; spread over the floor."""
    listed = list(floor.mounts)
    generated = [*_on_ceiling(floor), *_on_pillars(floor), *_on_walls(floor)]
    chosen = _spread(listed, generated, count)
    return tuple(
        Mount(m.id if m in listed else f"{m.on}_{k}", m.x, m.y, m.z, m.on, m.yaws) for k, m in enumerate(chosen)
    )


def _height(floor: Floor) -> float:
    return min(floor.ceiling_m - BELOW_CEILING_M, HIGHEST_M)


def _on_ceiling(floor: Floor) -> list[Mount]:
    """Above the middle of every road, and above its edges."""
    mounts = []
    for road in floor.roads:
        for offset in (0.0, sum(road.left), -sum(road.right)):
            for s in np.arange(ALONG_M / 2, road.path.length, ALONG_M):
                x, y, yaw = road.path.at(s)
                place = x - offset * np.sin(yaw), y + offset * np.cos(yaw)
                mounts.append(Mount("", float(place[0]), float(place[1]), _height(floor), "ceiling"))
    return _free(floor, mounts)


def _on_pillars(floor: Floor) -> list[Mount]:
    """On the face of every pillar that looks to the nearest road."""
    mounts = []
    for pillar in floor.pillars:
        surface = floor.surfaces[np.hypot(*(floor.surfaces[:, :2] - [pillar.x, pillar.y]).T).argmin()]
        away = _towards(surface, pillar.x, pillar.y) * (pillar.size / 2 + 0.1)
        mounts.append(Mount("", float(pillar.x + away[0]), float(pillar.y + away[1]), _height(floor), "pillar"))
    return mounts


def _towards(box: np.ndarray, x: float, y: float) -> np.ndarray:
    """Unit vector from a point to the nearest point of a box's axis."""
    axis = np.array([np.cos(box[6]), np.sin(box[6])])
    along = np.clip((np.array([x, y]) - box[:2]) @ axis, -box[3] / 2, box[3] / 2)
    offset = box[:2] + along * axis - [x, y]
    return offset / max(float(np.hypot(*offset)), 1e-6)


def _on_walls(floor: Floor) -> list[Mount]:
    """Along walls that are high enough, on both faces where these are on the floor."""
    x0, y0, x1, y1 = floor.outline()
    mounts = []
    for wall in floor.walls:
        if min(wall.height, wall.top if wall.end_height is None else wall.end_height) < floor.ceiling_m - 0.01:
            continue
        length = float(np.hypot(wall.x1 - wall.x0, wall.y1 - wall.y0))
        along = np.array([wall.x1 - wall.x0, wall.y1 - wall.y0]) / length
        normal = np.array([-along[1], along[0]]) * (wall.thickness / 2 + 0.15)
        for s in np.arange(2.0, length, 4.0):
            for side in (-1, 1):
                x, y = np.array([wall.x0, wall.y0]) + s * along + side * normal
                if x0 + 0.3 < x < x1 - 0.3 and y0 + 0.3 < y < y1 - 0.3:
                    mounts.append(Mount("", float(x), float(y), _height(floor), "wall"))
    return _free(floor, mounts)


def _free(floor: Floor, mounts: list[Mount]) -> list[Mount]:
    """Those that are not inside something solid."""
    spots = np.array([(m.x, m.y, 0.5, 0.05, 0.05, 1.0, 0.0) for m in mounts]).reshape(-1, 7)
    inside = bev_intersection(spots, floor.solid_boxes()).max(1, initial=0.0) > 0
    return [mount for mount, taken in zip(mounts, inside, strict=True) if not taken]


def _spread(listed: list[Mount], generated: list[Mount], count: int) -> list[Mount]:
    """The listed ones, then always the generated one that is farthest from all chosen (at least ``APART_M``)."""
    chosen = listed[:count]
    xy = np.array([(m.x, m.y) for m in generated]).reshape(-1, 2)
    if not len(xy):
        return chosen
    near = np.full(len(xy), np.inf)
    for mount in chosen:
        near = np.minimum(near, np.hypot(*(xy - [mount.x, mount.y]).T))
    while len(chosen) < count and near.max() > APART_M:
        best = int(near.argmax())
        chosen.append(generated[best])
        near = np.minimum(near, np.hypot(*(xy - xy[best]).T))
    return chosen
