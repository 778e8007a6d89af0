"""The augmentor follows its configuration and its generator, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from pcdet_avp.datasets.avp.augment import AUGMENTATIONS, Augmentor
from pcdet_avp.errors import ConfigError
from pcdet_avp.structures.frame import AgentView

FLIP = {"NAME": "random_world_flip", "ALONG_AXIS_LIST": ["x"], "PROBABILITY": 1.0}
TURN = {"NAME": "random_world_rotation", "WORLD_ROT_ANGLE": [0.2, 0.2], "AGENTS": ["ego", "infra"]}
SCALE = {"NAME": "random_world_scaling", "WORLD_SCALE_RANGE": [1.1, 1.1]}
PHOTO = {"NAME": "random_photometric", "BRIGHTNESS": 0.1, "CONTRAST": [0.8, 1.2], "NOISE_STD": 0.02}
PLACE = {"NAME": "random_localisation_noise", "POSITION_STD_M": 0.1, "YAW_STD_DEG": 0.2}


def augmentor(*entries, disabled=()):
    return Augmentor({"DISABLE_AUG_LIST": list(disabled), "AUG_CONFIG_LIST": list(entries)})


def rng(seed=0):
    return np.random.default_rng(seed)


def test_no_configuration_means_no_change(make_frame):
    frame = make_frame()
    assert Augmentor(None)(frame, rng()) is frame


def test_every_name_is_known_and_each_does_something(make_frame):
    frame = make_frame()
    entries = [FLIP, TURN, SCALE, PHOTO, PLACE]
    assert [entry["NAME"] for entry in entries] == list(AUGMENTATIONS)
    for entry in entries:
        changed = augmentor(entry)(frame, rng())
        pose, image = changed.ego_from_infra.matrix, changed.ego.image
        assert not (np.allclose(pose, frame.ego_from_infra.matrix) and np.array_equal(image, frame.ego.image))


def test_a_disabled_entry_does_nothing_and_can_be_disabled_later(make_frame):
    frame = make_frame()
    assert augmentor(FLIP, disabled=["random_world_flip"])(frame, rng()) is frame
    late = augmentor(FLIP, SCALE)
    late.disable_augmentation({"DISABLE_AUG_LIST": ["random_world_flip", "random_world_scaling"]})
    assert late(frame, rng()) is frame


def test_the_same_generator_gives_the_same_frame(make_frame):
    steps = augmentor(FLIP, TURN, SCALE, PHOTO)
    a, b, c = (steps(make_frame(), rng(seed)) for seed in (5, 5, 6))
    np.testing.assert_array_equal(a.ego.image, b.ego.image)
    np.testing.assert_array_equal(a.infra.points, b.infra.points)
    assert not np.array_equal(a.ego.image, c.ego.image)


def test_an_absent_sensor_does_not_change_the_others(make_frame):
    frame = make_frame()
    bare = replace(frame, ego=AgentView(frame.ego.world_from_agent, camera=frame.ego.camera))
    steps = augmentor(PHOTO, FLIP, TURN, SCALE, PLACE)
    whole, part = steps(frame, rng(3)), steps(bare, rng(3))
    np.testing.assert_array_equal(whole.infra.image, part.infra.image)
    np.testing.assert_array_equal(whole.infra.points, part.infra.points)
    np.testing.assert_array_equal(whole.ego_from_infra.matrix, part.ego_from_infra.matrix)


def test_a_probability_of_a_half_flips_half_the_frames(make_frame):
    frame, steps, generator = make_frame(), augmentor({**FLIP, "PROBABILITY": 0.5}), rng()
    flips = sum(steps(frame, generator) is not frame for _ in range(200))
    assert 70 < flips < 130


def test_brightness_and_contrast_are_what_they_say(make_frame):
    frame = make_frame()
    grey = replace(frame.ego, image=np.full((36, 64, 3), 100, np.uint8))
    grey.image[:, 32:] = 140
    only_contrast = {"NAME": "random_photometric", "BRIGHTNESS": 0.0, "CONTRAST": [0.5, 0.5]}
    image = augmentor(only_contrast)(replace(frame, ego=grey), rng()).ego.image
    assert sorted(np.unique(image)) == [110, 130]  # half the distance from the mean of 120
    only_noise = {"NAME": "random_photometric", "NOISE_STD": 0.02}
    noisy = augmentor(only_noise)(replace(frame, ego=grey), rng()).ego.image.astype(float)
    assert (noisy - grey.image).std() == pytest.approx(0.02 * 255, rel=0.1)


WRONG = [
    ({"NAME": "random_flop"}, r"AUG_CONFIG_LIST: unknown name 'random_flop'; known: random_world_flip"),
    ({**FLIP, "ALONG_AXIS_LIST": ["y"]}, r"ALONG_AXIS_LIST: expected \['x'\], found \['y'\]"),
    ({**TURN, "WORLD_ROT_ANGLE": [1, -1]}, r"random_world_rotation.WORLD_ROT_ANGLE: expected \[low, high\]"),
    ({**TURN, "AGENTS": ["drone"]}, r"AGENTS: expected some of ego, infra, found \['drone'\]"),
    ({**SCALE, "WORLD_SCALE_RANGE": [0, 1]}, r"WORLD_SCALE_RANGE: must be positive"),
    ({"NAME": "random_world_scaling"}, r"missing key WORLD_SCALE_RANGE"),
    ({"ALONG_AXIS_LIST": ["x"]}, r"missing key NAME"),
]


@pytest.mark.parametrize(("entry", "message"), WRONG)
def test_a_wrong_entry_is_refused_when_it_is_built(entry, message):
    with pytest.raises(ConfigError, match=message):
        augmentor(entry)


def test_a_wrong_name_to_disable_is_refused():
    with pytest.raises(ConfigError, match=r"DISABLE_AUG_LIST: unknown name 'flip'"):
        augmentor(FLIP, disabled=["flip"])


def test_a_key_of_another_augmentation_is_not_left_out_in_silence():
    with pytest.raises(ConfigError, match=r"random_world_flip: unknown key 'NOISE_STD'; known: ALONG_AXIS_LIST, PROB"):
        augmentor(FLIP | {"NOISE_STD": 0.1})
