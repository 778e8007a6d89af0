"""The triangle mesh of a car or van.

Mesh frame: origin on the floor below the centre of the box, x forward, y left, z up. The mesh fills its
length x width x height box exactly.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pcdet_avp.sim.meshes.car_body import body_mesh
from pcdet_avp.sim.meshes.car_details import detail_meshes
from pcdet_avp.sim.meshes.car_spec import CarSpec
from pcdet_avp.sim.meshes.mesh import Mesh


@lru_cache(maxsize=256)
def car_mesh(spec: CarSpec) -> Mesh:
    """The whole car, roughly 1300 triangles."""
    mesh = Mesh.merge([body_mesh(spec), *detail_meshes(spec)])
    return _fitted(mesh, np.array(spec.size))


def _fitted(mesh: Mesh, size: np.ndarray) -> Mesh:
    """Stretched by the last millimetres so that the bounds are the box exactly."""
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    target_low = np.array([-size[0] / 2, -size[1] / 2, 0.0])
    vertices = target_low + (mesh.vertices - low) / (high - low) * size
    return Mesh(vertices.astype(np.float32), mesh.faces, mesh.colors, mesh.materials, mesh.normals)
