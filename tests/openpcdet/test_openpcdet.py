"""Against a real OpenPCDet: set OPENPCDET_ROOT to a checkout, then run pytest -m slow on this file.

The checkout is copied first; what it needs and this machine lacks is replaced by ``openpcdet_shims.py``.
"""

import ast
import importlib.util
import json
import logging
import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import yaml

from pcdet_avp.config import load_config
from pcdet_avp.models import build_network
from pcdet_avp.models.weights.checkpoint_file import read_checkpoint

HERE = Path(__file__).parent
REPOSITORY = HERE.parents[1]
ROOT = os.environ.get("OPENPCDET_ROOT")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not ROOT, reason="set OPENPCDET_ROOT to a checkout of OpenPCDet"),
]
CONFIG = "cfgs/openpcdet/cp_tiny.yaml"
# Four frames are few: OpenPCDet's schedule divides by zero where PCT_START of all iterations is less than one.
SHORT = ("--batch_size", 1)
SHORT_SCHEDULE = ("OPTIMIZATION.PCT_START", 0.5)


def load_neighbour(name):
    spec = importlib.util.spec_from_file_location(name, HERE / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


contract = load_neighbour("openpcdet_contract")


@pytest.fixture(scope="module")
def openpcdet(tmp_path_factory):
    """A copy of the checkout, whose scripts write beside it."""
    copy = tmp_path_factory.mktemp("openpcdet") / "OpenPCDet"
    for name in ("pcdet", "tools"):
        shutil.copytree(Path(ROOT) / name, copy / name)
    return copy


def run(openpcdet, *words):
    environment = {**os.environ, "PYTHONPATH": f"{REPOSITORY}{os.pathsep}{HERE}", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=REPOSITORY, env=environment)
    assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]
    return done.stdout, done.stderr


def run_script(openpcdet, script, *words, data, overrides=()):
    """One of OpenPCDet's scripts through our runner; what it said."""
    runner = (HERE / "openpcdet_shims.py", "-m", "pcdet_avp.plugin", openpcdet / "tools" / script)
    overrides = ("DATA_CONFIG.DATA_PATH", data, *SHORT_SCHEDULE, *overrides)
    return "".join(run(openpcdet, *runner, *words, "--workers", 0, "--set", *overrides))


def run_code(openpcdet, code, **values):
    """Python with the shims installed, OpenPCDet importable and ``values`` defined; the JSON of its last line."""
    lines = [
        "import json, sys, openpcdet_shims",
        "openpcdet_shims.install()",
        f"sys.path.insert(0, {str(openpcdet)!r})",
    ]
    lines += [f"{name} = {str(value)!r}" for name, value in values.items()]
    return json.loads(run(openpcdet, "-c", "\n".join([*lines, code]))[0].splitlines()[-1])


@pytest.fixture(scope="module")
def trained(openpcdet, tiny_data):
    """What OpenPCDet's train.py said, and its folder of the run: one epoch and the evaluation after it."""
    said = run_script(openpcdet, "train.py", "--cfg_file", CONFIG, "--epochs", 1, *SHORT, data=tiny_data)
    return said, openpcdet / "output" / "openpcdet" / "cp_tiny" / "default"


def keywords_of_calls(source, table):
    """Keywords of the calls ``table[...](...)``, or ``table.__all__[...](...)``, in a source text."""
    for node in ast.walk(ast.parse(source)):
        lookup = node.func if isinstance(node, ast.Call) and isinstance(node.func, ast.Subscript) else None
        if lookup and ast.unparse(lookup.value) in (table, f"{table}.__all__"):
            yield {keyword.arg for keyword in node.keywords}


@pytest.mark.parametrize("table", contract.CONSTRUCTORS)
def test_the_written_description_is_openpcdets(table):
    file, name = contract.CALL_SITES[table]
    calls = list(keywords_of_calls((Path(ROOT) / file).read_text(), name))
    assert calls == [contract.CONSTRUCTORS[table]]


def test_openpcdets_own_functions_build_our_data_set_and_network(openpcdet, tiny_data):
    built = run_code(
        openpcdet,
        """
from pcdet_avp.plugin import register
register(); register()
from pcdet.config import cfg, cfg_from_yaml_file
from pcdet.datasets import build_dataloader
from pcdet.models import build_network, model_fn_decorator
cfg_from_yaml_file(config, cfg)
cfg.DATA_CONFIG.DATA_PATH = data
dataset, loader, _ = build_dataloader(cfg.DATA_CONFIG, cfg.CLASS_NAMES, 2, dist=False, workers=0, training=True)
network = build_network(cfg.MODEL, len(cfg.CLASS_NAMES), dataset)
loss, _, _ = model_fn_decorator()(network.train(), next(iter(loader)))
names = [type(dataset).__name__, type(network).__name__]
print(json.dumps([*names, len(dataset), int(network.global_step), loss.item()]))
""",
        config=REPOSITORY / CONFIG,
        data=tiny_data,
    )
    assert built[:4] == ["OpenPCDetAvpDataset", "OpenPCDetAvpCp", 4, 1]
    assert np.isfinite(built[4])


def test_one_epoch_by_openpcdets_training_script(trained):
    said, run = trained
    assert "End training openpcdet/cp_tiny(default)" in said
    content = read_checkpoint(run / "ckpt" / "checkpoint_epoch_1.pth")
    assert (content["epoch"], content["it"]) == (1, 4)
    assert int(content["model_state"]["global_step"]) == 4
    assert any((run / "tensorboard").iterdir())


def test_the_evaluation_at_its_end_counts_our_objects(trained):
    said, run = trained
    assert "loaded 147 of 147 tensors" in said
    assert "Car 3D AP (R40, %), camera_fov" in said
    with (run / "eval" / "eval_with_train" / "epoch_1" / "test" / "result.pkl").open("rb") as file:
        annotations = pickle.load(file)
    assert len(annotations) == 1
    assert annotations[0]["boxes_lidar"].shape[1] == 7


def test_openpcdets_test_script_evaluates_with_other_sensors(openpcdet, trained, tiny_data):
    checkpoint = trained[1] / "ckpt" / "checkpoint_epoch_1.pth"
    words = ("--cfg_file", CONFIG, "--ckpt", checkpoint, "--save_to_file", "--eval_tag", "alone")
    said = run_script(openpcdet, "test.py", *words, data=tiny_data, overrides=("DATA_CONFIG.SENSOR_SET", "C+none"))
    assert "Evaluation done" in said
    folder = trained[1] / "eval" / "epoch_1" / "test" / "alone"
    assert (folder / "result.pkl").exists()
    assert len(list((folder / "final_result" / "data").glob("*.txt"))) == 1


def test_openpcdets_checkpoint_goes_on_in_its_own_training(openpcdet, trained, tiny_data):
    words = ("--cfg_file", CONFIG, "--epochs", 2, "--extra_tag", "longer", *SHORT)
    said = run_script(
        openpcdet, "train.py", *words, "--ckpt", trained[1] / "ckpt" / "checkpoint_epoch_1.pth", data=tiny_data
    )
    assert "loaded 147 of 147 tensors" in said
    content = read_checkpoint(trained[1].parent / "longer" / "ckpt" / "checkpoint_epoch_2.pth")
    assert (content["epoch"], content["it"]) == (2, 8)


def pointpillar_config(backbone):
    """OpenPCDet's PointPillar and head on our data, with our pillars and a backbone of ours."""
    cfg = yaml.safe_load((REPOSITORY / CONFIG).read_text())
    anchors = [
        {**anchor, "anchor_rotations": [0, 1.57], "feature_map_stride": 1}
        for anchor in cfg["MODEL"]["DENSE_HEAD"]["ANCHOR_GENERATOR_CONFIG"]
    ]
    head = {**cfg["MODEL"]["DENSE_HEAD"], "ANCHOR_GENERATOR_CONFIG": anchors, "CLASS_AGNOSTIC": False}
    assigner = {"NAME": "AxisAlignedTargetAssigner", "POS_FRACTION": -1.0, "SAMPLE_SIZE": 512}
    assigner |= {"NORM_BY_NUM_EXAMPLES": False, "MATCH_HEIGHT": False, "BOX_CODER": "ResidualCoder"}
    post = {**cfg["MODEL"]["POST_PROCESSING"], "OUTPUT_RAW_SCORE": False}
    post["NMS_CONFIG"] = {**post["NMS_CONFIG"], "NMS_TYPE": "nms_gpu", "MULTI_CLASSES_NMS": False}
    cfg["MODEL"] = {
        "NAME": "PointPillar",
        "VFE": {"NAME": "DynamicPillars", "NUM_FILTERS": [16], "NORM": "batch"},
        "MAP_TO_BEV": {"NAME": "PillarScatter", "NUM_BEV_FEATURES": 16},
        "BACKBONE_2D": {**cfg["MODEL"]["BACKBONE_2D"], **backbone},
        "DENSE_HEAD": {**head, "DIR_LIMIT_OFFSET": 0.0, "TARGET_ASSIGNER_CONFIG": assigner},
        "POST_PROCESSING": post,
    }
    cfg["DATA_CONFIG"]["TRAIN_SENSOR_SETS"] = ["CL+none"]
    return cfg


BACKBONES = {
    "attention": {"NAME": "DeformableAttentionBackbone", "ATTENTION": {"HEADS": 4, "POINTS": 4}},
    "compressed": {"NAME": "CompressedBackbone", "COMPRESSION": {"REDUCTION": 4}},
}


@pytest.mark.parametrize("name", BACKBONES)
def test_our_pieces_train_in_openpcdets_pointpillar(openpcdet, tiny_data, tmp_path, name):
    """One epoch and the evaluation; OpenPCDet's optimiser moved every weight of ours that has a gradient."""
    config = tmp_path / f"{name}.yaml"
    config.write_text(yaml.safe_dump(pointpillar_config(BACKBONES[name])))
    said = run_script(openpcdet, "train.py", "--cfg_file", config, "--epochs", 2, *SHORT, data=tiny_data)
    assert "Evaluation done" in said
    folder = next((openpcdet / "output").rglob(f"{name}/default/ckpt"))
    first, second = (read_checkpoint(folder / f"checkpoint_epoch_{n}.pth")["model_state"] for n in (1, 2))
    ours = [key for key in first if key.startswith(("vfe.", "backbone_2d.")) and first[key].is_floating_point()]
    assert any(key.startswith(("backbone_2d.attention.", "backbone_2d.codec.")) for key in ours)
    assert [key for key in ours if torch.equal(first[key], second[key])] == []


OPENPCDET_SIDE = """
import numpy as np, torch
from types import SimpleNamespace
from torch import nn
import os
os.chdir(tools)
from pcdet.config import cfg, cfg_from_yaml_file
from pcdet.models import build_network
cfg_from_yaml_file("cfgs/kitti_models/pointpillar.yaml", cfg)
low, high = np.float32(cfg.DATA_CONFIG.POINT_CLOUD_RANGE).reshape(2, 3)
dataset = SimpleNamespace(
    class_names=cfg.CLASS_NAMES, point_feature_encoder=SimpleNamespace(num_point_features=4),
    grid_size=np.array([432, 496, 1]), point_cloud_range=np.r_[low, high], voxel_size=[0.16, 0.16, 4],
    depth_downsample_factor=None,
)
torch.manual_seed(0)
network = build_network(cfg.MODEL, 3, dataset).eval()
for module in network.modules():
    if isinstance(module, (nn.BatchNorm1d, nn.BatchNorm2d)):
        for tensor in (module.weight, module.running_var):
            nn.init.uniform_(tensor, 0.5, 2.0)
        for tensor in (module.bias, module.running_mean):
            nn.init.normal_(tensor, 0.0, 0.3)
optimizer_state = {"lr": np.float64(0.003)}  # what OpenPCDet's checkpoints hold since its rates come from np.cos
state = {"model_state": network.state_dict(), "optimizer_state": optimizer_state, "epoch": 80, "it": 1}
torch.save(state, folder + "/openpcdet.pth", _use_new_zipfile_serialization=False)
rng = np.random.default_rng(0)
cells = np.stack(np.unravel_index(rng.choice(376 * 280, 300, replace=False), (376, 280)), 1)  # rows, columns
counts = rng.integers(1, 33, 300)
voxels = np.zeros((300, 32, 4), np.float32)
for i, ((row, column), count) in enumerate(zip(cells, counts)):
    corner = [column * 0.16 + 0.001, row * 0.16 - 30.08 + 0.001, -1.7, 0]
    voxels[i, :count] = corner + rng.random((count, 4)) * [0.158, 0.158, 2.5, 1]
rows_of_kitti = cells[:, 0] + round((39.68 - 30.08) / 0.16)
coords = np.stack([0 * counts, 0 * counts, rows_of_kitti, cells[:, 1]], 1)
batch = {"voxels": voxels, "voxel_num_points": counts, "voxel_coords": coords}
batch = {key: torch.from_numpy(np.float32(value)) for key, value in batch.items()}
with torch.no_grad():
    features = network.vfe({**batch, "batch_size": 1})["pillar_features"]
    canvas = torch.zeros(1, 64, 376, 280)
    canvas[0, :, cells[:, 0], cells[:, 1]] = features.T
    maps = network.backbone_2d({"spatial_features": canvas.clone()})["spatial_features_2d"]
points = np.concatenate([v[:n] for v, n in zip(voxels, counts)])
np.savez(folder + "/openpcdet.npz", points=points, cells=cells, features=features, maps=maps)
import logging
from pcdet_avp.plugin import register
register()
cfg.MODEL.BACKBONE_2D.NAME = "DeformableAttentionBackbone"
wrapped = build_network(cfg.MODEL, 3, dataset).eval()
wrapped.load_params_from_file(folder + "/openpcdet.pth", logging.getLogger("openpcdet"))
with torch.no_grad():
    same = wrapped.backbone_2d({"spatial_features": canvas})["spatial_features_2d"]
parameters = sum(p.numel() for p in network.parameters())
print(json.dumps([len(state["model_state"]), parameters, float((same - maps).abs().max())]))
"""


def test_a_real_pointpillar_and_ours_with_its_weights_agree(openpcdet, tmp_path):
    """KITTI's PointPillar of OpenPCDet's own configuration, with random weights and statistics; 300 pillars."""
    tensors, parameters, change = run_code(openpcdet, OPENPCDET_SIDE, tools=openpcdet / "tools", folder=tmp_path)
    assert (tensors, parameters) == (127, 4_834_888)
    assert change < 1e-4  # its own loader puts the weights behind our attention, which starts as nothing
    cfg = load_config(REPOSITORY / "cfgs" / "avp" / "ablations" / "from_openpcdet.yaml")
    data = cfg.DATA_CONFIG
    geometry = {"point_cloud_range": data.POINT_CLOUD_RANGE, "voxel_size": data.VOXEL_SIZE}
    encoding = SimpleNamespace(num_point_features=4)
    dataset = SimpleNamespace(class_names=cfg.CLASS_NAMES, point_feature_encoder=encoding, **geometry)
    network = build_network(cfg.MODEL, 2, dataset).eval()
    network.load_params_from_file(tmp_path / "openpcdet.pth", logging.getLogger("openpcdet"), to_cpu=True)
    theirs = np.load(tmp_path / "openpcdet.npz")
    points = torch.from_numpy(theirs["points"]) + torch.tensor([0.0, 0.0, 1.73, 0.0])
    encoder = network.encoders["ego_lidar"]
    with torch.no_grad():
        features, coords = encoder.vfe.encode(torch.cat([torch.zeros(len(points), 1), points], 1), 1)
        maps = network.backbone_2d.encode(encoder.map_to_bev_module.scatter(features, coords, 1))
    order = np.lexsort(theirs["cells"].T[::-1])
    assert coords[:, 2:].tolist() == theirs["cells"][order].tolist()
    torch.testing.assert_close(features, torch.from_numpy(theirs["features"][order]), atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(maps, torch.from_numpy(theirs["maps"]), atol=1e-4, rtol=1e-4)
