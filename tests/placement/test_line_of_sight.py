"""What a placement's sensors see, and what the car sees, each by its own sensor models."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from plan_files import STRAIGHT, parsed, written

from pcdet_avp.config import load_config
from pcdet_avp.placement import visibility
from pcdet_avp.placement.line_of_sight import PlacedLineOfSight
from pcdet_avp.placement.safe_speed import VEHICLE_CONFIG
from pcdet_avp.placement.sensors import SensorModels
from pcdet_avp.placement.settings import PlacementSettings
from pcdet_avp.placement.visibility import Study
from pcdet_avp.sim.actors import Pedestrian
from pcdet_avp.sim.meshes.mesh import Material, box_mesh
from pcdet_avp.sim.meshes.pedestrian_spec import draw_pedestrian
from pcdet_avp.sim.plans.floor import FloorLayout
from pcdet_avp.sim.rays.raytracer import RayTracer, TriangleScene
from pcdet_avp.sim.render.lights import Lighting
from pcdet_avp.sim.rig import Rig
from pcdet_avp.sim.trajectories import Waypoints
from pcdet_avp.sim.world import World
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.roadside_unit import MountedUnit
from pcdet_avp.structures.sensor_set import SensorSet

WALL = "    walls:\n      - {kind: wall, line: [[14, -3], [14, 3]]}\n"
SLOTS = "    rows:\n      - {road: main, side: right, s_m: 20, count: 2, width_m: 2.5, length_m: 5}\n"


@pytest.mark.parametrize(("range_m", "seen"), [(65.0, 1), (11.0, 1), (9.0, 0)])
def test_a_roadside_lidar_sees_as_far_as_its_model_says(tmp_path, range_m, seen):
    """A wall stands before the car; a LiDAR behind it hangs 10.2 m from a pedestrian."""
    layout = FloorLayout(parsed(tmp_path, more=WALL), 0.0, 40.0)
    person = Pedestrian(0, draw_pedestrian(np.random.default_rng(0), "adult"), Waypoints(((20, -1), (20, 1)), 1.5))
    world = World(layout, [person], Lighting(()))
    world.set_ego(8.0, 0.0, 0.0)
    cfg = load_config(VEHICLE_CONFIG)
    grid = BevGrid.from_range(cfg.POINT_CLOUD_RANGE, cfg.VOXEL_SIZE)
    unit = MountedUnit(30.0, 0.0, 2.6, np.pi, np.radians(10.0), camera=False, lidar=True)
    models = replace(SensorModels(), range_m=range_m)
    eye = PlacedLineOfSight(Rig.from_config(cfg.SENSORS).ego, "C", (unit,), models, grid)
    eye.begin(SimpleNamespace(threats=(SimpleNamespace(object_id=0),), layout=layout), ())
    assert len(eye.perceive(world, 0, SensorSet.parse("C+none")).boxes) == seen


def test_whom_the_car_sees_does_not_depend_on_the_roadsides_sensors(tmp_path):
    file, hidden = str(written(tmp_path, STRAIGHT, SLOTS)), []
    beside = RayTracer([TriangleScene([(box_mesh((0.3, 3, 1.4), (17, -4, 0.7), (0.5,) * 3, Material.CONCRETE), -1)])])
    for models in (SensorModels(), replace(SensorModels(), width=96, height=54, hfov=1.0, range_m=5.0)):
        for vehicle in ("C", "CL"):
            study = Study(file, "A", 4, 0, replace(PlacementSettings(), sensors=models, vehicle=vehicle))
            hidden.append(visibility._hidden(study, beside))
    assert 0 < hidden[0].mean() < 1
    assert np.array_equal(hidden[0], hidden[2])
    assert np.array_equal(hidden[1], hidden[3])
