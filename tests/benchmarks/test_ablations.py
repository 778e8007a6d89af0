"""benchmarks/ablations.py: rows of another run are not read as this one's; what early fusion is."""

import numpy as np
import pytest

from pcdet_avp.errors import ConfigError
from pcdet_avp.structures.frame import AgentView, Frame
from pcdet_avp.structures.pose import Pose


@pytest.fixture(scope="module")
def ablations(load_benchmark):
    return load_benchmark("ablations")


def test_a_folder_with_rows_of_another_run_is_refused(ablations, tmp_path):
    """Rows that are done are read again: those of two epochs are not those of four."""
    asked = {"weights": "abc", "epochs": 2, "combos": ["C+C", "CL+CL"]}
    ablations.claim(tmp_path, asked)
    ablations.claim(tmp_path, asked)
    with pytest.raises(ConfigError, match=r"asked.json: epochs: holds rows of 2, this run asks for 4; choose another"):
        ablations.claim(tmp_path, asked | {"epochs": 4})


@pytest.mark.parametrize("combo", ["CL+CL", "CL+C", "C+CL", "C+C"])
def test_in_early_fusion_the_roadside_gives_its_cloud_and_nothing_else(ablations, monkeypatch, combo):
    """It stands 10 m before the vehicle and faces it: 3 m before the roadside are 7 m before the vehicle."""
    own, sent = np.array([[1, 2, 3, 0.5]], np.float32), np.array([[3, 1, 0, 0.25]], np.float32)
    ego_from_infra, image = Pose.from_xyz_yaw(10.0, 0.0, yaw=np.pi), np.zeros((2, 2, 3), np.uint8)
    ego = AgentView(Pose.identity(), image=image, points=own if combo.startswith("CL") else None)
    infra = AgentView(ego_from_infra, image=image, points=sent if combo.endswith("CL") else None)
    frame = Frame("0000/000", 0.0, ego, infra)
    monkeypatch.setattr(ablations.AvpDataset, "read", lambda *_: frame)
    read = object.__new__(ablations.MergedClouds).read(0, None)
    assert read.infra.image is None
    assert read.infra.points is None
    assert read.ego.image is image
    expected = {"CL+CL": [[1, 2, 3, 0.5], [7, -1, 0, 0.25]], "CL+C": own.tolist()}.get(combo)
    assert (read.ego.points is None) if expected is None else np.allclose(read.ego.points, expected, atol=1e-6)
