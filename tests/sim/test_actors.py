"""Road users: meshes and label boxes stand where the trajectory says."""

import numpy as np
import pytest

from pcdet_avp.sim.actors import Car, Pedestrian, box_at, mesh_at, released, stands
from pcdet_avp.sim.meshes.car_spec import draw_car
from pcdet_avp.sim.meshes.pedestrian_spec import draw_pedestrian
from pcdet_avp.sim.trajectories import Pacing, Path, Route, Standing
from pcdet_avp.structures.pose import Pose


def local_vertices(actor, time_s):
    """The mesh in the frame of the actor's label box, whose origin is on the floor."""
    box = box_at(actor, time_s)
    return Pose.from_xyz_yaw(box[0], box[1], yaw=box[6]).inverse().apply(mesh_at(actor, time_s).vertices)


def test_a_turning_car_fills_its_label_box():
    path = Path.from_pose(-11.0, -20.0, np.pi / 2).straight(10.0).arc(6.0, np.pi / 2)
    car = Car(3, draw_car(np.random.default_rng(0)), Route(path, 5.0))
    for time_s in (0.0, 1.0, 2.7):
        vertices = local_vertices(car, time_s)
        half = np.array(car.spec.size) / 2
        np.testing.assert_allclose(vertices.min(0), [-half[0], -half[1], 0], atol=1e-3)
        np.testing.assert_allclose(vertices.max(0), [half[0], half[1], car.spec.height], atol=1e-3)


def test_a_pedestrians_box_is_the_capsule_while_the_legs_swing():
    pedestrian = Pedestrian(5, draw_pedestrian(np.random.default_rng(1), "adult"), Pacing(-9, -3, -9, 3, 1.5))
    reach = [np.ptp(local_vertices(pedestrian, t)[:, 0]) for t in np.arange(0, 1.4, 0.1)]
    assert max(reach) > min(reach) + 0.2
    boxes = np.array([box_at(pedestrian, t) for t in (0.0, 0.4, 1.0)])
    assert boxes[:, 3:5] == pytest.approx(0.375)
    assert boxes[:, 1] == pytest.approx([-3.0, -2.4, -1.5])
    assert boxes[:, 2] == pytest.approx(pedestrian.spec.height / 2)


def test_a_waiting_pedestrian_is_released():
    pedestrian = Pedestrian(0, draw_pedestrian(np.random.default_rng(1)), Pacing(0, -3, 0, 3, 1.5, start_s=np.inf))
    assert box_at(pedestrian, 100.0)[1] == pytest.approx(-3.0)
    assert box_at(released(pedestrian, 100.0), 101.0)[1] == pytest.approx(-1.5)


def test_only_standing_ones_belong_to_what_is_built_once():
    spec = draw_car(np.random.default_rng(0))
    assert stands(Car(0, spec, Standing(0, 0, 0)))
    assert not stands(Car(0, spec, Route(Path.from_pose(0, 0, 0).straight(1), 1.0)))
