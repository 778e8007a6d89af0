"""Pedestrian targets of Euro NCAP's protocols: their sizes, and how they come to their speed."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from pcdet_avp.sim.meshes.pedestrian_spec import PedestrianSpec, draw_pedestrian

WALKING_MPS = 5 / 3.6  # all pedestrian targets of CPNCO, CPTA and CPRA
# Length along the walk, width, height in metres (Euro NCAP 2026).
CHILD_M, ADULT_M = (0.711, 0.298, 1.154), (0.6, 0.5, 1.8)


@dataclass(frozen=True)
class ProtocolPedestrian(PedestrianSpec):
    """A person whose box is the protocol's target, not CARLA's capsule."""

    along_m: float = CHILD_M[0]
    across_m: float = CHILD_M[1]

    @property
    def size(self) -> tuple[float, float, float]:
        """dx, dy, dz of the label box in metres; dx lies along the walk."""
        return (self.along_m, self.across_m, self.height)


def draw_target(rng: np.random.Generator, kind: str) -> ProtocolPedestrian:
    """``kind`` child or adult: the protocol's size, clothes and skin drawn at random."""
    person, (along_m, across_m, height) = draw_pedestrian(rng, kind), CHILD_M if kind == "child" else ADULT_M
    looks = {f.name: getattr(person, f.name) for f in fields(PedestrianSpec)} | {"height": height}
    return ProtocolPedestrian(**looks, along_m=along_m, across_m=across_m)
