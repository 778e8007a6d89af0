"""One frame at the paper's size goes through capture, disk and loading in every run."""

from pathlib import Path

import numpy as np
import pytest

from pcdet_avp.config import load_config
from pcdet_avp.datasets.avp.record import read_frame, write_frame
from pcdet_avp.generate import scene_config
from pcdet_avp.sim.rig import Rig, capture
from pcdet_avp.sim.scenarios.training_scene import draw_training_scene

CFGS = Path(__file__).parents[1] / "cfgs"
FRAMES_IN_FULL_SET = 2240
LIMIT_BYTES = 8e9


@pytest.fixture(scope="module")
def captured():
    cfg = load_config(CFGS / "dataset_configs" / "avp_full.yaml")
    scene = draw_training_scene(np.random.default_rng(1), scene_config(cfg.GENERATE))
    return capture(scene.seek(2), Rig.from_config(cfg.SENSORS), (0, 0, 0), "0000/000")


def test_a_full_size_frame_survives_disk_and_fits_the_budget(captured, tmp_path):
    size = write_frame(tmp_path, captured)
    loaded = read_frame(tmp_path, "0000/000")
    assert size * FRAMES_IN_FULL_SET < LIMIT_BYTES
    for agent in ("ego", "infra"):
        before, after = getattr(captured, agent), getattr(loaded, agent)
        assert before.image.shape == (540, 960, 3)
        assert 300_000 < len(before.points) <= 64 * 6000
        assert np.array_equal(after.points, before.points)
        assert np.array_equal(after.image, before.image)
        np.testing.assert_allclose(after.depth, before.depth, atol=6e-4)
        assert before.camera.fx == pytest.approx(480)
    np.testing.assert_array_equal(loaded.labels.boxes, captured.labels.boxes)
    np.testing.assert_allclose(loaded.ego_from_infra.matrix, captured.ego_from_infra.matrix)


def test_share_of_returns_is_what_drop_off_leaves(captured):
    """In a closed garage nearly every ray that is cast comes back."""
    for view in (captured.ego, captured.infra):
        assert len(view.points) / (64 * 6000) == pytest.approx(0.9, abs=0.02)
