"""Pictures against trigonometry and against what light does."""

from dataclasses import replace

import numpy as np
import pytest

from pcdet_avp.errors import GeometryError
from pcdet_avp.sim.garage import Lamp
from pcdet_avp.sim.meshes.car import car_mesh
from pcdet_avp.sim.meshes.car_spec import CarSpec
from pcdet_avp.sim.meshes.loft import quad
from pcdet_avp.sim.meshes.mesh import Material, box_mesh
from pcdet_avp.sim.rays.raytracer import RayTracer, TriangleScene
from pcdet_avp.sim.render import image_sensor
from pcdet_avp.sim.render.camera import render
from pcdet_avp.sim.render.lights import (
    BOUNCE,
    NEAR_M,
    SMOOTH_AT_M,
    Lighting,
    draw_lighting,
    headlamps_of,
    nearness,
)
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.pose import Pose

CAMERA = PinholeCamera.looking_ahead(480, 270, np.pi / 2, 0.0, 1.8)
GREY = (0.3, 0.3, 0.3)
LAMPS = tuple(Lamp(x, y, 3.0, 1.0) for x in (4.0, 10.0, 16.0) for y in (-3.0, 3.0))
NOISELESS = Lighting(LAMPS, read_noise=0.0, shot_noise=0.0)
HERE = Pose.identity()


def floor(material=Material.CLOTH):
    corners = (-50, -50, 0), (90, -50, 0), (90, 50, 0), (-50, 50, 0)
    return quad(*corners, GREY, material), -1


def picture(parts, lighting=NOISELESS, camera=CAMERA, seed=0):
    return render(RayTracer([TriangleScene(parts)]), camera, HERE, lighting, np.random.default_rng(seed))


def brightness(rendered, u, v):
    return float(rendered.image[v - 2 : v + 3, u - 2 : u + 3].mean())


def pixel_of(point, camera=CAMERA):
    uv, _ = camera.project(np.array(point, float))
    return int(uv[0]), int(uv[1])


def test_a_box_ten_metres_ahead_lands_on_the_pixels_of_trigonometry():
    """Its front face, 2 m wide and 1.8 m high, 10 m away: fx = 240, so 240 * 1 / 10 = 24 px to either side."""
    seen = picture([floor(), (box_mesh((2, 2, 1.8), (11, 0, 0.9), GREY, Material.PAINT), 5)])
    rows, cols = np.nonzero(seen.instance == 5)
    assert (cols.min(), cols.max() + 1) == (240 - 24, 240 + 24)
    assert rows.min() == pytest.approx(135, abs=1)
    assert rows.max() + 1 == pytest.approx(135 + 240 * 1.8 / 10, abs=1)
    np.testing.assert_allclose(seen.depth[140:175, 220:260], 10.0, atol=1e-3)


def test_the_floors_depth_is_the_analytic_one():
    """Row v sees the floor at depth h f / (v - cy)."""
    depth = picture([floor()]).depth
    v = np.arange(150, 270)
    np.testing.assert_allclose(depth[150:, 240], 1.8 * 240 / (v + 0.5 - 135), rtol=1e-4)


def test_a_camera_may_stand_exactly_on_a_wall():
    """As ``World`` puts the vehicle before anybody moves it: in the plane of the wall behind the road's beginning."""
    wall = quad((0, -9, 0), (0, 9, 0), (0, 9, 4), (0, -9, 4), GREY, Material.CONCRETE), -1
    seen = picture([floor(), wall])
    assert np.isfinite(seen.depth).all()


def test_a_pitched_cameras_depth_agrees_with_projection():
    camera = PinholeCamera.looking_ahead(320, 180, np.pi / 2, 0.5, 7.0, pitch_down=np.radians(30))
    depth = picture([floor()], camera=camera).depth
    for point in ((8.0, 0.0, 0.0), (20.0, -6.0, 0.0), (12.0, 9.0, 0.0)):
        (u, v), expected = camera.project(np.array(point))
        assert depth[int(v), int(u)] == pytest.approx(expected, rel=0.03)


def test_nothing_within_65_metres_has_depth_zero_and_no_instance_where_no_face():
    wall = box_mesh((1, 200, 20), (70.5, 0, 0), GREY, Material.CONCRETE)
    seen = picture([(wall, 3)])
    assert seen.depth[135, 240] == 0
    assert seen.instance[135, 240] == 3
    assert picture([floor()]).instance[10, 10] == -1


def test_an_object_between_lamp_and_floor_throws_a_shadow():
    lighting = replace(NOISELESS, lamps=(Lamp(10.0, 0.0, 3.0, 1.0),), ambient_occlusion=False)
    roof = box_mesh((1.5, 1.5, 0.05), (10, 0, 2.4), GREY, Material.PAINT), 1
    u, v = pixel_of((10.0, 0.6, 0.0))
    lit, dark = brightness(picture([floor()], lighting), u, v), brightness(picture([floor(), roof], lighting), u, v)
    assert dark < 0.6 * lit
    without = replace(lighting, shadow_lamps=0)
    assert brightness(picture([floor(), roof], without), u, v) == pytest.approx(lit, rel=0.1)


def test_the_gap_under_a_car_is_dark():
    car = car_mesh(CarSpec("suv", 4.8, 2.0, 1.8, (0.6, 0.6, 0.6))).transformed(Pose.from_xyz_yaw(9, 0, yaw=np.pi / 2))
    u, v = pixel_of((8.2, 0.0, 0.0))
    assert brightness(picture([floor(), (car, 0)]), u, v) < 0.6 * brightness(picture([floor()]), u, v)


def test_corners_are_darker_with_ambient_occlusion():
    lighting = replace(NOISELESS, lamps=(Lamp(-20.0, 0.0, 3.0, 0.0),), ambient=1.0)
    wall = box_mesh((1, 40, 6), (8.5, 0, 3), GREY, Material.CLOTH), 1
    u, v = pixel_of((7.8, 0.0, 0.0))
    plain = picture([floor(), wall], replace(lighting, ambient_occlusion=False))
    assert brightness(picture([floor(), wall], lighting), u, v) < 0.9 * brightness(plain, u, v)


def test_a_failed_lamp_gives_less_light():
    failed = replace(NOISELESS, lamps=(replace(LAMPS[0], intensity=0.0), *LAMPS[1:]))
    u, v = pixel_of((4.0, -3.0, 0.0))
    assert brightness(picture([floor()], failed), u, v) < 0.9 * brightness(picture([floor()]), u, v)


def test_the_floors_brightness_follows_lamberts_and_the_inverse_square_law():
    """Below a lamp at height h, at distance d from it: h^2 / d^4, plus the bounced share; the lens darkens corners."""
    lighting = replace(NOISELESS, lamps=(Lamp(12.0, 0.0, 7.0, 1.0),), ambient=0.0, ambient_occlusion=False)
    seen = picture([floor()], lighting)
    curve = image_sensor.tone_curve(lighting.gamma).astype(float)
    measured, expected = [], []
    for y in (0.0, -2.0, -4.0, -6.0, -8.0, -10.0):
        u, v = pixel_of((12.0, y, 0.0))
        x, z = (u + 0.5) / 240 - 1, (v + 0.5) / 135 - 1
        signal = np.searchsorted(curve, seen.image[v, u, 0]) / image_sensor.CURVE
        measured.append(signal / (1 - image_sensor.VIGNETTING / 2 * (x * x + z * z)))
        d2 = y * y + 49.0
        expected.append(49.0 / d2**2 * (1 + BOUNCE))
    np.testing.assert_allclose(np.array(measured) / measured[0], np.array(expected) / expected[0], rtol=0.06)


def test_near_and_far_lamps_add_up_to_all_lamps():
    """At a cell's centre: what is followed by ray plus the smooth part is the sum over lamps of I lz^2 / d^4."""
    rng = np.random.default_rng(0)
    lamps = tuple(
        Lamp(x, y, 3.0 + rng.uniform(0, 0.5), rng.uniform(0.2, 1)) for x in np.arange(0, 60, 7.0) for y in (-3, 4)
    )
    field = replace(NOISELESS, lamps=lamps).field
    i, j = 17, 9
    centre = field.origin + (np.array([i, j]) + 0.5) * 2.0
    rows = np.array([(a.x - centre[0], a.y - centre[1], a.z - SMOOTH_AT_M, a.intensity) for a in lamps])
    flat2 = np.square(rows[:, :2]).sum(1)
    each = rows[:, 3] * rows[:, 2] ** 2 / (flat2 + rows[:, 2] ** 2) ** 2
    assert ((flat2 > NEAR_M**2) & (each > 0)).any()
    near = (each * nearness(flat2)).sum()
    assert near + field.smooth[i, j, 3] == pytest.approx(each.sum(), rel=1e-4)
    assert sorted(field.lamps[i, j, field.lamps[i, j, :, 3] > 0, 4]) == sorted(
        np.flatnonzero(flat2 < (NEAR_M + 1.42) ** 2)
    )


def test_the_same_seed_gives_the_same_image_and_another_seed_another():
    noisy = replace(NOISELESS, read_noise=0.004, shot_noise=0.02)
    a, b, c = (picture([floor()], noisy, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(a.image, b.image)
    assert (a.image != c.image).mean() > 0.2
    np.testing.assert_array_equal(a.depth, c.depth)


def test_noise_has_the_stated_deviation():
    radiance = np.full((200, 300, 3), 0.2, np.float32)
    curve = np.round(np.arange(image_sensor.CURVE) / (image_sensor.CURVE - 1) * 255).astype(np.uint8)
    images = [np.empty(radiance.shape, np.uint8) for _ in range(2)]
    for image, noise in zip(images, (0.0, 0.05), strict=True):
        image_sensor.expose(radiance, np.float32(1), np.float32(noise), np.float32(0.1), np.uint64(9), curve, image)
    middle = np.s_[90:110, 130:170]
    assert images[1][middle].std() == pytest.approx(255 * np.hypot(0.05, 0.1 * np.sqrt(0.2)), rel=0.05)
    assert images[0][middle].std() == pytest.approx(255 * 0.1 * np.sqrt(0.2), rel=0.05)
    flat = images[1][middle].astype(float) - images[1][middle].mean()
    assert abs(np.corrcoef(flat[..., 0].ravel(), flat[..., 1].ravel())[0, 1]) < 0.1


def test_glass_is_darker_than_paint_and_a_lamp_is_white():
    parts = [
        (box_mesh((1, 1, 1), (8, y, 1.0), color, material), k)
        for k, (y, color, material) in enumerate(
            (
                (-2, (0.6, 0.6, 0.6), Material.PAINT),
                (0, (0.02, 0.02, 0.02), Material.GLASS),
                (2, (1, 1, 1), Material.LAMP),
            )
        )
    ]
    seen = picture([floor(), *parts])
    paint, glass, lamp = (seen.image[seen.instance == k].mean() for k in range(3))
    assert glass < 0.6 * paint
    assert lamp > 245


def test_a_mirror_like_coat_shows_the_lamp_above():
    """A glossy floor is brightest where it mirrors the lamp; a matt one where it is lit most."""
    lighting = replace(NOISELESS, lamps=(Lamp(10.0, 0.0, 3.0, 1.0),), ambient=0.0)
    u, v = pixel_of((10 * 1.8 / 4.8, 0.0, 0.0))
    glass, matt = picture([floor(Material.GLASS)], lighting), picture([floor()], lighting)
    assert brightness(glass, u, v) > 1.2 * brightness(matt, u, v)


def test_head_lamps_light_what_is_ahead_and_the_cars_own_lamp_faces():
    dark = replace(NOISELESS, lamps=(Lamp(10.0, 0.0, 3.0, 0.0),))
    lit = replace(dark, headlamps=(headlamps_of(Pose.identity(), 4.8),))
    u, v = pixel_of((9.0, 0.0, 0.0))
    before, after = picture([floor()], dark), picture([floor()], lit)
    assert brightness(after, u, v) > brightness(before, u, v) + 20
    car_pose = Pose.from_xyz_yaw(8.0, 0.0)
    spec = CarSpec("sedan", 4.8, 1.9, 1.5, (0.1, 0.1, 0.1))
    car = car_mesh(spec).transformed(car_pose), 0
    off, on = picture([car], dark), picture([car], replace(dark, headlamps=(headlamps_of(car_pose, spec.length),)))
    assert on.image[..., 0].astype(int).max() > off.image[..., 0].astype(int).max() + 50


def test_a_drawn_lighting_follows_from_its_seed():
    a, b = (draw_lighting(LAMPS, np.random.default_rng(3)) for _ in range(2))
    assert a == b
    assert a != draw_lighting(LAMPS, np.random.default_rng(4))


def test_bad_lighting_is_refused():
    with pytest.raises(GeometryError, match="shadow_lamps"):
        Lighting(LAMPS, shadow_lamps=9)
    with pytest.raises(GeometryError, match="exposure"):
        Lighting(LAMPS, exposure=0.0)


def test_a_garage_without_lamps_is_black_but_renders():
    assert picture([floor()], replace(NOISELESS, lamps=(), ambient=0.0)).image.max() < 10


@pytest.mark.parametrize("first_row", [8, 64, 71])
def test_rows_that_nobody_reads_stay_dark_and_change_no_other(first_row):
    """Noise, ambient occlusion, the lens and the patterns of the shading reach over neighbouring rows."""
    car = car_mesh(CarSpec("suv", 4.8, 2.0, 1.8, (0.6, 0.1, 0.1))).transformed(Pose.from_xyz_yaw(4.5, 0.6, yaw=0.4))
    ceiling = quad((-50, -50, 3.4), (-50, 50, 3.4), (90, 50, 3.4), (90, -50, 3.4), GREY, Material.CONCRETE), -1
    world = RayTracer([TriangleScene([floor(Material.FLOOR), ceiling, (car, 5)])])
    whole, part = (render(world, CAMERA, HERE, Lighting(LAMPS), np.random.default_rng(3), r) for r in (0, first_row))
    for name in ("image", "depth", "instance"):
        assert np.array_equal(getattr(whole, name)[first_row:], getattr(part, name)[first_row:])
    dark = max(0, first_row - 16)
    assert (whole.depth[:dark] > 0).all()
    assert not part.depth[:dark].any()


def test_a_camera_that_stands_still_takes_the_pictures_of_one_that_just_came():
    """It remembers the surfaces it saw: of this place and direction, under these lamps, and only where nobody drives
    by. Each picture is taken twice, since what came once is not remembered yet."""
    standing = [floor(), (box_mesh((2, 2, 1.8), (11, 3, 0.9), GREY, Material.PAINT), 5)]
    kept, mesh = TriangleScene(standing), car_mesh(CarSpec("sedan", 4.8, 1.9, 1.5, (0.1, 0.1, 0.1)))
    turned = PinholeCamera.looking_ahead(480, 270, np.pi / 2, 0.0, 1.8, 0.2)  # at the same place
    fewer = replace(NOISELESS, lamps=LAMPS[1:])
    beams = (headlamps_of(Pose.from_xyz_yaw(2.0, -2.0), 4.5),)
    nobody, here, there = None, Pose.from_xyz_yaw(9.0, -1.0, yaw=1.0), Pose.from_xyz_yaw(12.0, 2.0)
    situations = [
        (CAMERA, NOISELESS, nobody),
        (CAMERA, NOISELESS, here),
        (CAMERA, replace(NOISELESS, headlamps=beams), there),
        (turned, NOISELESS, there),
        (turned, fewer, nobody),
        (CAMERA, NOISELESS, nobody),
    ]
    for camera, lighting, pose in [s for situation in situations for s in (situation, situation)]:
        moving = [TriangleScene([(mesh.transformed(pose), 7)])] if pose else []
        shots = [
            render(RayTracer([scene, *moving]), camera, HERE, lighting, np.random.default_rng(0))
            for scene in (kept, TriangleScene(standing))
        ]
        for name in ("image", "depth", "instance"):
            np.testing.assert_array_equal(*(getattr(shot, name) for shot in shots), err_msg=f"{name} {pose}")
