"""Import paths of the first documentation still lead to the same things."""

import importlib

import pytest

# Module and name as docs/ and README.md gave them -> where it lives now.
PUBLISHED = {
    ("pcdet_avp.closed_loop.episode", "run_episode"): "pcdet_avp.closed_loop.episode",
    ("pcdet_avp.closed_loop.episode", "Episode"): "pcdet_avp.closed_loop.episode",
    ("pcdet_avp.closed_loop.film", "film_episode"): "pcdet_avp.closed_loop.video.video",
    ("pcdet_avp.closed_loop.gym_env", "AvpEnv"): "pcdet_avp.closed_loop.gym_env",
    ("pcdet_avp.closed_loop.perceiver", "Perceived"): "pcdet_avp.closed_loop.perception.perceiver",
    ("pcdet_avp.closed_loop.perceiver", "PerceiverSettings"): "pcdet_avp.closed_loop.perception.perceiver",
    ("pcdet_avp.closed_loop.perceiver", "build_perceiver"): "pcdet_avp.closed_loop.perception.factory",
    ("pcdet_avp.sim.episode_table", "draw_scenario"): "pcdet_avp.sim.scenarios.table",
}


@pytest.mark.parametrize(("module", "name"), PUBLISHED)
def test_a_published_path_leads_to_what_lives_elsewhere_now(module, name):
    if module.endswith("gym_env"):
        pytest.importorskip("gymnasium")
    assert getattr(importlib.import_module(module), name).__module__ == PUBLISHED[module, name]
