"""The ego's own footprint."""

import numpy as np

from pcdet_avp.structures.ego import overlaps_ego


def test_ego_footprint_is_4_8_by_1_9_metres():
    pedestrians = np.array([[x, y, 0.9, 0.4, 0.4, 1.8, 0.0] for x, y in [(2.5, 0), (2.7, 0), (0, 1.1), (0, 1.2)]])
    assert overlaps_ego(pedestrians).tolist() == [True, False, True, False]
