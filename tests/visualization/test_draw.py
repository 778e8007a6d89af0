"""Lines land where geometry says."""

import numpy as np

from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.visualization.draw import BevCanvas, draw_boxes

RED = np.array([[255, 0, 0]], np.uint8)


def test_a_box_ahead_is_drawn_inside_its_projected_outline():
    camera = PinholeCamera.looking_ahead(200, 100, np.pi / 2, 0.0, 1.5)  # f = 100 px
    box = np.array([[11.0, 0, 1.5, 2, 2, 2, 0]])  # front face at 10 m: +-1 m is +-10 px
    drawn = draw_boxes(np.zeros((100, 200, 3), np.uint8), camera, box, RED)
    rows, cols = np.nonzero(drawn[..., 0] > 60)
    np.testing.assert_allclose([rows.min(), rows.max(), cols.min(), cols.max()], [40, 60, 90, 110], atol=1)


def test_a_box_behind_leaves_the_image_alone_and_one_around_the_camera_does_not_raise():
    camera = PinholeCamera.looking_ahead(200, 100, np.pi / 2, 0.0, 1.5)
    blank = np.zeros((100, 200, 3), np.uint8)
    assert draw_boxes(blank, camera, np.array([[-5.0, 0, 1, 2, 2, 2, 0]]), RED).max() == 0
    assert draw_boxes(blank, camera, np.array([[0.0, 0, 1.5, 2, 2, 2, 0.3]]), RED).max() > 0


def test_a_point_brightens_its_own_pixel_only():
    canvas = BevCanvas(0, -5, 10, 5, px_per_m=10)
    before = canvas.image.copy()
    canvas.points(np.array([[2.55, 1.25], [200.0, 0.0]]), (255, 255, 255), strength=5.0)
    changed = np.argwhere((canvas.image != before).any(-1))
    assert changed.tolist() == [[37, 25]]
