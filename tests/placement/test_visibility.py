"""Lines of sight worked out by hand, and pixel counts against those of rendered rays."""

from dataclasses import replace

import numpy as np
import pytest
from plan_files import parsed

from pcdet_avp.placement.sensors import SensorModels, pitch_by_height
from pcdet_avp.placement.settings import PlacementSettings
from pcdet_avp.placement.spots import CHILD_M, HEIGHTS, find_spots
from pcdet_avp.placement.visibility import camera_pixels, clear_points, lidar_returns
from pcdet_avp.sim.meshes.mesh import Material, box_mesh
from pcdet_avp.sim.rays.raytracer import RayTracer, TriangleScene
from pcdet_avp.sim.rays.sightline import camera_window, hits_on, lidar_window
from pcdet_avp.structures.roadside_unit import MountedUnit

EYE = np.array([[0.0, 0.0, 1.8]])
CHILD = np.array([CHILD_M])
MODELS = SensorModels()


def box(size, centre):
    return box_mesh(size, centre, (0.5, 0.5, 0.5), Material.CONCRETE)


def tracer_with(*boxes):
    return RayTracer([TriangleScene([(mesh, -1) for mesh in boxes])])


def test_a_wall_between_hides_and_beside_does_not():
    child = np.array([[10.0, 0.0]])
    assert not clear_points(tracer_with(box((0.2, 4, 3), (5, 0, 1.5))), EYE, child, CHILD).any()
    assert clear_points(tracer_with(box((0.2, 4, 3), (5, 3, 1.5))), EYE, child, CHILD).all()
    assert clear_points(tracer_with(box((0.2, 4, 3), (12, 0, 1.5))), EYE, child, CHILD).all()  # behind the child


@pytest.mark.parametrize("bonnet", [0.5, 0.8, 1.0, 1.2, 1.35, 1.6])
def test_over_a_bonnet_the_upper_points_show(bonnet):
    """The line from the eye to a point passes the obstacle's far edge at a height that similar triangles give."""
    near, far, child_x = 4.0, 8.0, 10.0
    clear = clear_points(
        tracer_with(box((far - near, 4, bonnet), ((near + far) / 2, 0, bonnet / 2))),
        EYE,
        np.array([[child_x, 0.0]]),
        CHILD,
    )[0]
    for k, share in enumerate(np.repeat(HEIGHTS, 2)):
        target = share * CHILD_M[1]
        at_edge = 1.8 + (target - 1.8) * far / child_x
        assert abs(at_edge - bonnet) > 0.01  # the case is clear-cut
        assert clear[k] == (at_edge > bonnet)


@pytest.mark.parametrize("x", [5.0, 12.0, 25.0])
@pytest.mark.parametrize("height", [2.7, 7.0])
def test_pixels_and_returns_are_those_of_rays_at_a_mesh(x, height):
    unit = MountedUnit(0.0, 0.0, height, 0.0, pitch_by_height(height))
    eye, xy = np.array([[0.0, 0.0, height]]), np.array([[x, 1.0]])
    mesh = box((0.02, *CHILD_M), (x, 1.0, CHILD_M[1] / 2))  # a board that faces the sensor
    tracer = RayTracer([TriangleScene([(box((1, 1, 1), (-50, 0, 0)), -1)]), TriangleScene([(mesh, 7)])])
    for sensor, window, count in (
        (MODELS.camera_of(unit), camera_window, camera_pixels),
        (MODELS.lidar_of(unit), lidar_window, lidar_returns),
    ):
        rays = window(sensor, unit.world_from_unit, mesh).rays().reshape(-1, 3)
        cast = hits_on(tracer, eye[0], rays, 7, 1e6)
        one_row = CHILD_M[0] / x / (MODELS.azimuth_span / MODELS.columns) if count is lidar_returns else 30
        assert count(MODELS, eye, 0.0, unit.pitch_down_rad, xy, CHILD)[0] == pytest.approx(cast, rel=0.15, abs=one_row)


def test_beside_and_behind_nothing_is_seen():
    xy = np.array([[-5.0, 0.0], [1.0, 8.0], [8.0, 0.0]])
    eyes, sizes = np.repeat(EYE, 3, 0), np.repeat(CHILD, 3, 0)
    assert (camera_pixels(MODELS, eyes, 0.0, 0.0, xy, sizes) > 0).tolist() == [False, False, True]
    assert (lidar_returns(MODELS, eyes, 0.0, 0.0, xy, sizes) > 0).tolist() == [False, False, True]
    assert (camera_pixels(MODELS, eyes, np.pi, 0.0, xy, sizes) > 0).tolist() == [True, False, False]


def test_spots_lie_between_slots_and_on_arms(tmp_path):
    rows = "    rows:\n      - {road: main, side: right, s_m: 10, count: 2, width_m: 2.5, length_m: 5}\n"
    side = (
        "      - {id: side, start: [30, -20], hdg_deg: 90, geometry: [{line_m: 20}], lanes: {right: [3], left: [3]}}\n"
    )
    junction = "    junctions:\n      - {id: J, kind: t, at: [30, 0], roads: [main, side]}\n"
    settings = replace(PlacementSettings(), arm_m=(5.0,))
    found = find_spots(parsed(tmp_path, more=side + rows + junction), settings)
    gaps = [spot for spot in found.spots if spot.kind == "gap"]
    assert [(round(s.x, 3), round(s.y, 3)) for s in gaps] == [(10.0, -4.0), (12.5, -4.0), (15.0, -4.0)]
    assert [spot.slots for spot in gaps] == [(0,), (0, 1), (1,)]
    arms = [spot for spot in found.spots if spot.kind == "arm" and spot.y < -4]
    assert [(s.x, s.y) for s in arms] == [(31.5, -8.0)]  # the lane that comes out, 5 m before the junction's edge
    lanes = {each.lane for each in found.passes if found.spots[each.spot] == gaps[1]}
    assert lanes == {0, 1}  # both directions of the road pass by
