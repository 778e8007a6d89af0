"""Frames to run an exported network on."""

import pytest

from pcdet_avp.structures.sensor_set import SensorSet


@pytest.fixture(scope="session")
def frames(to_export):
    """Recorded frames with all sensors."""
    return [to_export.dataset.read(index, SensorSet.parse("CL+CL")) for index in range(len(to_export.dataset))]
