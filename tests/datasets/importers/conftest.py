"""Frames of the embedded garage, and how its sensors are mounted, for what ``written.py`` writes."""

from types import SimpleNamespace

import pytest
from datasets.importers.written import mounts_of, write_carla, write_dair_v2x, write_opv2v

from pcdet_avp.datasets.avp.manifest import read_manifest
from pcdet_avp.datasets.avp.record import read_frame


@pytest.fixture(scope="session")
def garage(tiny_data):
    """Four frames with all sensors."""
    return [read_frame(tiny_data, scene.frame_ids[0]) for scene in read_manifest(tiny_data).scenes[:4]]


@pytest.fixture(scope="session")
def foreign(garage, tmp_path_factory):
    """The same frames in the three layouts: format -> folder."""
    root, mounts = tmp_path_factory.mktemp("foreign"), mounts_of(garage)
    write_opv2v(root / "opv2v" / "validate" / "2026_01_02_03_04_05", garage, mounts)
    write_carla(root / "carla" / "garage", garage, mounts)
    write_dair_v2x(root / "dair_v2x", garage)
    return SimpleNamespace(opv2v=root / "opv2v", carla=root / "carla", dair_v2x=root / "dair_v2x")
