"""Frames to run an exported network on."""

import pytest

from pcdet_avp.structures.sensor_set import SensorSet


@pytest.fixture(scope="session")
def frames(trained):
    """Two recorded frames with all sensors."""
    return [trained.dataset.read(index, SensorSet.parse("CL+CL")) for index in range(2)]
