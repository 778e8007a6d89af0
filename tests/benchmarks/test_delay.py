"""benchmarks/delay.py: the past that is rendered is the past of the recorded frame."""

import numpy as np
import pytest

from pcdet_avp.datasets.avp.manifest import read_manifest
from pcdet_avp.datasets.avp.record import read_frame
from pcdet_avp.errors import ConfigError


@pytest.fixture(scope="module")
def delay(load_benchmark):
    return load_benchmark("delay")


def test_without_delay_the_record_comes_out_again_and_a_moment_before_it_something_else(delay, tiny_data):
    past, manifest = delay.Past(tiny_data), read_manifest(tiny_data)
    past.manifest.generator["GENERATE"]["FRAMES_PER_SCENE"] = 1  # as the fixture drew the scenes
    differ = []
    for scene in manifest.scenes[:2]:
        recorded = read_frame(tiny_data, scene.frame_ids[0])
        delay.check_recorded(past.infra(recorded, 0.0), recorded)
        later = past.infra(recorded, -0.5)  # these scenes have one frame, so the past lies ahead
        assert np.array_equal(later.ego_from_infra.matrix, recorded.ego_from_infra.matrix)  # the mast stands still
        differ.append(not np.array_equal(later.infra.image, recorded.infra.image))
        with pytest.raises(ConfigError, match="differs from the record"):
            delay.check_recorded(past.infra(recorded, -0.5), recorded)
    assert all(differ)


def test_the_vehicle_s_pose_of_the_past_is_the_recorded_one_without_delay(delay, tiny_data):
    past, manifest = delay.Past(tiny_data), read_manifest(tiny_data)
    past.manifest.generator["GENERATE"]["FRAMES_PER_SCENE"] = 1
    recorded = read_frame(tiny_data, manifest.scenes[0].frame_ids[0])
    now = past.world_from_ego(recorded, 0.0)
    np.testing.assert_allclose(now.matrix, recorded.ego.world_from_agent.matrix, atol=1e-9)


def test_the_vehicle_was_elsewhere_before(delay, tiny_data):
    """Scenes of several frames: the vehicle drives straight on at 1 to 5 m/s."""
    past, manifest = delay.Past(tiny_data), read_manifest(tiny_data)
    past.manifest.generator["GENERATE"]["FRAMES_PER_SCENE"] = 3
    recorded = read_frame(tiny_data, manifest.scenes[0].frame_ids[0])
    now, ahead = (past.world_from_ego(recorded, delay_s).translation for delay_s in (0.0, -0.5))
    assert 0.2 < np.linalg.norm(ahead - now) <= 2.5
