"""CARLA's own Transform, BoundingBox and Vector3D, without a server, against our conversion of what they write.

Run with carla==0.9.16 installed (``pip install --no-deps carla==0.9.16``); skipped without.
"""

import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pcdet_avp.datasets.importers import axes
from pcdet_avp.structures.boxes import box_corners

carla = pytest.importorskip("carla")
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
FLOAT32_M = 2e-5  # CARLA's numbers are float32


def drawn(seed):
    rng = np.random.default_rng(seed)
    place = carla.Location(*(float(v) for v in rng.uniform(-50, 50, 3)))
    pitch, yaw, roll = (float(v) for v in rng.uniform([-30, -180, -20], [30, 180, 20]))
    return carla.Transform(place, carla.Rotation(pitch=pitch, yaw=yaw, roll=roll)), rng


def ours(transform):
    place, turn = transform.location, transform.rotation
    return axes.pose_from_unreal([place.x, place.y, place.z], turn.roll, turn.pitch, turn.yaw)


@pytest.mark.parametrize("seed", range(10))
def test_a_transform_is_carlas_own_matrix_mirrored_on_both_sides(seed):
    transform, _ = drawn(seed)
    expected = MIRROR @ np.array(transform.get_matrix()) @ MIRROR
    np.testing.assert_allclose(ours(transform).matrix, expected, atol=FLOAT32_M)


@pytest.mark.parametrize("seed", range(10))
def test_a_point_of_a_sensor_goes_where_carla_moves_it(seed):
    transform, rng = drawn(seed)
    point = rng.uniform(-20, 20, 3)
    moved = transform.transform(carla.Location(*(float(v) for v in point)))  # a copy of ours: it changes its argument
    found = ours(transform).apply(axes.points_from_unreal(point))
    np.testing.assert_allclose(found, [moved.x, -moved.y, moved.z], atol=FLOAT32_M)


@pytest.mark.parametrize("seed", range(10))
def test_the_vertices_of_a_box_are_carlas(seed):
    """An upright actor; the bounding box has a place of its own in the actor's frame."""
    transform, rng = drawn(seed)
    transform = carla.Transform(transform.location, carla.Rotation(yaw=transform.rotation.yaw))
    centre, extent = rng.uniform(-1, 1, 3), rng.uniform([1, 0.5, 0.5], [3, 1.2, 1])
    box = carla.BoundingBox(carla.Location(*map(float, centre)), carla.Vector3D(*map(float, extent)))
    theirs = np.array([[v.x, -v.y, v.z] for v in box.get_world_vertices(transform)])
    found = box_corners(axes.unreal_box(ours(transform), centre, extent)[None])[0]
    apart = np.linalg.norm(found[:, None] - theirs[None], axis=2)
    assert sorted(apart.argmin(1)) == list(range(8))
    assert apart.min(1).max() < FLOAT32_M


def test_the_recorder_of_the_documentation_writes_what_carlas_objects_hold(tmp_path):
    page = (Path(__file__).parents[3] / "docs" / "own_data.md").read_text()
    code = next(block for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "def transform_of" in block)
    names = {}
    exec(compile(code, "own_data.md", "exec"), names)
    transform, _ = drawn(3)
    written = names["transform_of"](transform)
    place, turn = written["location"], written["rotation"]
    found = axes.pose_from_unreal([place["x"], place["y"], place["z"]], turn["roll"], turn["pitch"], turn["yaw"])
    np.testing.assert_allclose(found.matrix, MIRROR @ np.array(transform.get_matrix()) @ MIRROR, atol=FLOAT32_M)
    assert names["xyz"](carla.Vector3D(1, 2, 3)) == {"x": 1, "y": 2, "z": 3}
    box = carla.BoundingBox(carla.Location(4, 5, 6), carla.Vector3D(2, 1, 1))
    box.rotation = carla.Rotation(yaw=30)
    names["write_scene"](tmp_path, SimpleNamespace(id=7), {}, [box])
    (static,) = json.loads((tmp_path / "scene.json").read_text())["static_cars"]
    assert static["location"] == {"x": 4, "y": 5, "z": 6}
    assert static["rotation"]["yaw"] == pytest.approx(30)
    assert static["extent"] == {"x": 2, "y": 1, "z": 1}
