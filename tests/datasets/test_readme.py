"""The exporter's example in the layout's README runs as printed, and what it writes loads."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import pcdet_avp.datasets.avp
from pcdet_avp.config import load_config
from pcdet_avp.datasets.avp.avp_dataset import AvpDataset
from pcdet_avp.datasets.avp.record import read_frame, write_frame

README = Path(pcdet_avp.datasets.avp.__file__).parent / "README.md"
TINY = Path(__file__).parents[2] / "cfgs" / "dataset_configs" / "avp_tiny.yaml"


@pytest.fixture
def foreign(tmp_path, monkeypatch):
    """The folder that the README's block writes."""
    code = re.search(r"```python\n(.*?)```", README.read_text(), re.DOTALL).group(1)
    assert "pcdet_avp" not in code
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {})
    return tmp_path / "my_recording"


def test_the_foreign_frame_loads_through_the_data_set_class(foreign):
    cfg = load_config(TINY)
    dataset = AvpDataset(cfg, ["Car", "Pedestrian"], training=False, root_path=foreign)
    sample = dataset[0]
    assert sample["source_present"].tolist() == [True, True, True, False]
    np.testing.assert_allclose(sample["points"], [[8, 1, 0.5, 0.9], [8, -1, 0.5, 0.8]])
    np.testing.assert_allclose(sample["gt_boxes"], [[10, 3, 0.75, 4.4, 1.8, 1.5, 1.57, 1]])
    assert sample["images"].shape == (108, 192, 3)
    assert (sample["depth_maps"] == 8.0).all()
    assert not sample["depth_maps_infra"].any()


def test_its_calibration_means_what_the_readme_says(foreign):
    frame = read_frame(foreign, "garage_1/000000")
    ahead, left = np.array([[8.0, 0.0, 1.8], [8.0, 4.0, 1.8]])
    np.testing.assert_allclose(frame.ego.camera.project(ahead)[0], [160, 90])
    np.testing.assert_allclose(frame.ego.camera.project(left)[0], [80, 90])
    np.testing.assert_allclose(frame.ego_from_infra.apply(np.array([5.0, 0, 0])), [15.0, 1.7, 0], atol=1e-12)


def test_every_field_that_our_writer_writes_is_in_the_readme(tmp_path, make_frame):
    text = README.read_text()
    write_frame(tmp_path / "a", make_frame())
    write_frame(tmp_path / "b", make_frame(point_list=True))
    for file in tmp_path.glob("*/scenes/*/*/frame.json"):
        keys = {key for key in keys_of(json.loads(file.read_text())) if "." not in key}  # no file names
        assert len(keys) > 20
        for key in keys:
            assert re.search(rf'[`"]{re.escape(key)}[`"]|\b{re.escape(key)}\b', text), key


def keys_of(value):
    if isinstance(value, dict):
        return set(value) | {key for item in value.values() for key in keys_of(item)}
    return {key for item in value for key in keys_of(item)} if isinstance(value, list) else set()
