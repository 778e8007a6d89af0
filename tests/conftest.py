"""Settings of the whole test run."""

import os
from dataclasses import replace
from pathlib import Path

import pytest
from filelock import FileLock
from hypothesis import settings

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # see pcdet_avp.cli; before anything imports torch

# No deadline per example: the first call of a numba function compiles it, and test machines are busy.
settings.register_profile("avp", deadline=None, max_examples=50)
settings.load_profile("avp")


@pytest.fixture(scope="session")
def tiny_data(tmp_path_factory):
    """A data set of six scenes of one frame each, made by the simulator for ``cfgs/avp/cp_tiny.yaml``; its folder.

    Processes that share the tests (``pytest -n 2``) share it, too: the first one makes it, and compiles for all.
    """
    base = tmp_path_factory.getbasetemp()
    root = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "tiny_data"
    with FileLock(f"{root}.lock"):
        if not (root / "dataset.json").exists():
            make_tiny_data(root)
    return root


def make_tiny_data(root):
    from pcdet_avp.config import load_config, plain
    from pcdet_avp.datasets.avp.manifest import write_manifest
    from pcdet_avp.generate import SceneJob, make_scene, plan

    path = Path(__file__).parents[1] / "cfgs" / "dataset_configs" / "avp_tiny.yaml"
    cfg = load_config(path)
    cfg.GENERATE.FRAMES_PER_SCENE = 1
    manifest = plan(cfg, frames=6, seed=1)
    for number, scene in enumerate(manifest.scenes):
        make_scene(SceneJob(str(root), number, scene, manifest.seed, manifest.generator))
    as_configured = {**manifest.generator, "GENERATE": plain(load_config(path).GENERATE)}  # as the tests' configuration
    write_manifest(root, replace(manifest, complete=True, generator=as_configured))
