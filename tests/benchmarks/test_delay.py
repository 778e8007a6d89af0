"""benchmarks/delay.py: the past that is rendered is the past of the recorded frame."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pcdet_avp.bandwidth.late_fusion import Boxes
from pcdet_avp.bandwidth.parts import Parts
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


def test_a_record_may_be_off_by_what_another_processor_rounds(delay, tiny_data):
    recorded = read_frame(tiny_data, read_manifest(tiny_data).scenes[0].frame_ids[0])

    def with_levels(numbers, levels):
        image = recorded.infra.image.astype(int)
        image.reshape(-1)[:numbers] += np.where(image.reshape(-1)[:numbers] < 128, levels, -levels)
        return replace(recorded, infra=replace(recorded.infra, image=image.astype(np.uint8)))

    delay.check_recorded(with_levels(1, 1), recorded)
    for numbers, levels in ((1, 2), (recorded.infra.image.size // 1000, 1)):
        with pytest.raises(ConfigError, match="differs from the record"):
            delay.check_recorded(with_levels(numbers, levels), recorded)


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


def test_each_frame_is_run_once_per_delay_and_combination_and_read_from_disk_afterwards(delay, tiny_data, tmp_path):
    past, frame_id = delay.Past(tiny_data), read_manifest(tiny_data).scenes[0].frame_ids[0]
    past.manifest.generator["GENERATE"]["FRAMES_PER_SCENE"] = 1
    past.infra = lambda recorded, delay_s: recorded  # rendering is tested above

    asked = []

    def found(index, combo, pose, maps):
        asked.append(combo)
        return Boxes(torch.ones(1, 7), torch.tensor([len(asked) / 10]), torch.ones(1, dtype=torch.int64))

    dataset = SimpleNamespace(frame_ids=[frame_id], read=lambda index, sensors: read_frame(tiny_data, frame_id))
    network = SimpleNamespace(dataset=dataset, maps=lambda seen: [], found=found)
    args = SimpleNamespace(combos="C+CL,CL+CL", delays_ms=[0.0, 50.0], motion_ignored=True)
    labels = [delay.label(ms, ignored) for ms, ignored in delay.conditions(args)]
    parts = Parts(tmp_path, ["C+CL", "CL+CL"], labels)
    for _ in range(2):
        [result] = delay.results(args, network, past, parts, [0])
    assert asked == 3 * ["C+CL", "CL+CL"]  # no delay; 50 ms; 50 ms, motion ignored
    scores = [result.found[combo, label].scores.item() for label in labels for combo in ("C+CL", "CL+CL")]
    np.testing.assert_allclose(scores, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
