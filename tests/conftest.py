"""Settings of the whole test run."""

import os
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import settings

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # see pcdet_avp.cli; before anything imports torch

# No deadline per example: the first call of a numba function compiles it, and test machines are busy.
settings.register_profile("avp", deadline=None, max_examples=50)
settings.load_profile("avp")


@pytest.fixture(scope="session")
def tiny_data(tmp_path_factory):
    """A data set of six scenes of one frame each, made by the simulator for ``cfgs/avp/cp_tiny.yaml``; its folder."""
    from pcdet_avp.config import load_config, plain
    from pcdet_avp.datasets.avp.manifest import write_manifest
    from pcdet_avp.generate import SceneJob, make_scene, plan

    path = Path(__file__).parents[1] / "cfgs" / "dataset_configs" / "avp_tiny.yaml"
    cfg = load_config(path)
    cfg.GENERATE.FRAMES_PER_SCENE = 1
    manifest, root = plan(cfg, frames=6, seed=1), tmp_path_factory.mktemp("tiny_data")
    for number, scene in enumerate(manifest.scenes):
        make_scene(SceneJob(str(root), number, scene, manifest.seed, manifest.generator))
    as_configured = {**manifest.generator, "GENERATE": plain(load_config(path).GENERATE)}  # as the tests' configuration
    write_manifest(root, replace(manifest, complete=True, generator=as_configured))
    return root
