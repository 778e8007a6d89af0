"""Settings of the whole test run."""

import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from filelock import FileLock
from hypothesis import settings

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # see pcdet_avp.cli; before anything imports torch

# No deadline per example: the first call of a numba function compiles it, and test machines are busy.
settings.register_profile("avp", deadline=None, max_examples=50)
settings.load_profile("avp")

SMALLEST = """
_BASE_CONFIG_: {base}
MODEL:
    CAMERA_ENCODER:
        IMAGE_BACKBONE: {{BLOCKS: [1], WIDTHS: [16]}}
        MAP_TO_BEV: {{HEIGHTS: 2}}
        ATTENTION: null
    BACKBONE_2D:
        {{LAYER_NUMS: [1], LAYER_STRIDES: [1], NUM_FILTERS: [16], UPSAMPLE_STRIDES: [1], NUM_UPSAMPLE_FILTERS: [16]}}
"""


@pytest.fixture(scope="session")
def tiny_data(tmp_path_factory):
    """A data set of six scenes of one frame each, made by the simulator for ``cfgs/avp/cp_tiny.yaml``; its folder.

    Processes that share the tests (``pytest -n 2``) share it, too: the first one makes it, and compiles for all.
    """
    root = shared_folder(tmp_path_factory) / "tiny_data"
    with FileLock(f"{root}.lock"):
        if not (root / "dataset.json").exists():
            make_tiny_data(root)
    return root


def shared_folder(tmp_path_factory):
    """A folder of this run that all of its processes have."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


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


@pytest.fixture(scope="session")
def to_export(tiny_data, tmp_path_factory):
    """Configuration and its file, data set, a network with random weights in every layer, and its checkpoint.

    The network is smaller than ``cp_tiny``, because exporting takes seconds for every stage. The scores' bias is
    raised, so that boxes come out.
    """
    import torch

    from pcdet_avp.config import load_config, plain
    from pcdet_avp.datasets import build_dataset
    from pcdet_avp.engine import checkpoint
    from pcdet_avp.models import build_network

    folder = tmp_path_factory.mktemp("trained")
    base = Path(__file__).parents[1] / "cfgs" / "avp" / "cp_tiny.yaml"
    (folder / "smallest.yaml").write_text(SMALLEST.format(base=base))
    cfg = load_config(folder / "smallest.yaml")
    cfg.DATA_CONFIG.DATA_PATH = str(tiny_data)
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split="test")
    torch.manual_seed(0)
    network = build_network(cfg.MODEL, len(cfg.CLASS_NAMES), dataset).eval().requires_grad_(False)
    for parameter in network.parameters():
        if not parameter.any():  # starts at zero: its layer would be idle
            parameter.normal_(std=0.2)
    network.dense_head.conv_cls.bias += 2.0
    path = folder / "random.pth"
    content = {"model_state": network.state_dict(), "meaning": dict(network.meaning.values), "config": plain(cfg)}
    checkpoint.save(path, content | {"score_thresholds": {"Car": 0.1, "Pedestrian": 0.1}})
    return SimpleNamespace(cfg=cfg, cfg_file=folder / "smallest.yaml", dataset=dataset, network=network, path=path)


@pytest.fixture(scope="session")
def exported(to_export, tmp_path_factory):
    """The folder that the network of ``to_export`` was exported to; all processes of a run share it."""
    for name in ("onnx", "onnxscript", "onnxruntime"):
        pytest.importorskip(name, reason=f"exporting needs {name}: pip install 'pcdet_avp[export]'")
    from pcdet_avp.models.export.write import export_network

    folder = shared_folder(tmp_path_factory) / "exported" / "tiny"
    facts = {"precision": "float32", "weights_hash": "0123", "score_thresholds": {"Car": 0.1, "Pedestrian": 0.1}}
    shape = to_export.dataset.prepare_config.image_shape
    with FileLock(shared_folder(tmp_path_factory) / "exported.lock"):
        if not folder.exists():
            export_network(to_export.network, to_export.cfg.CLASS_NAMES, shape, folder, facts)
    return folder
