"""Maps and stamps that the tests of the link share."""

import numpy as np
import pytest

from pcdet_avp.link import MapStamp


def sparse_map(rng, shape, share, dtype=np.float32):
    """A map (C, H, W) of normal values in which about this share of the elements is not zero."""
    return (rng.normal(size=shape) * (rng.random(shape) < share)).astype(dtype)


@pytest.fixture
def stamp():
    return MapStamp(frame_id=7, time_us=350_000, modality="lidar", x_m=12.5, y_m=-3.25, yaw_rad=0.5)


@pytest.fixture
def make_map():
    return sparse_map
