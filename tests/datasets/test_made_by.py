"""Data on disk that are not those of the configuration are refused by the key, recordings of others pass."""

import copy
import json
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from easydict import EasyDict

from pcdet_avp.config import apply_overrides, load_config
from pcdet_avp.datasets import build_dataset
from pcdet_avp.datasets.avp.made_by import check_made_by, describes
from pcdet_avp.datasets.avp.manifest import Manifest
from pcdet_avp.errors import RecordError

CFG = load_config(Path(__file__).parents[2] / "cfgs" / "dataset_configs" / "avp_tiny.yaml")


@pytest.fixture
def cfg():
    return copy.deepcopy(CFG)


def made(cfg=CFG, seed=0):
    generator = {"SENSORS": cfg["SENSORS"], "GENERATE": cfg["GENERATE"]}
    return Manifest((), seed=seed, generator=json.loads(json.dumps(generator)))  # as it comes from dataset.json


def check(cfg, manifest):
    check_made_by(manifest, cfg, Path("data"))


def test_data_of_this_configuration_pass_whatever_only_the_network_reads(cfg):
    cfg.VOXEL_SIZE, cfg.DATA_AUGMENTOR = [0.32, 0.32, 4.0], None
    cfg.GENERATE.GARAGE = {}
    check(cfg, made())


def test_masts_that_are_drawn_by_default_ranges_are_not_the_fixed_one(cfg):
    """An empty section MAST draws a unit for every scene; without one it hangs where SENSORS says."""
    drawn, written_out = copy.deepcopy(cfg), copy.deepcopy(cfg)
    drawn["GENERATE"]["MAST"], written_out["GENERATE"]["MAST"] = {}, {"HEIGHT_M": [2.3, 7.0]}
    check(written_out, made(drawn))
    for configuration, data in ((cfg, drawn), (drawn, cfg)):
        with pytest.raises(RecordError, match=r"these data were made with DATA_CONFIG\.GENERATE\.MAST"):
            check(configuration, made(data))


def test_data_of_a_time_before_the_scenes_settings_were_written_out_pass(cfg):
    """Commit c063a55 wrote no GARAGE and no SCENE, or only what differed, in lower case."""
    old = copy.deepcopy(cfg)
    del old["GENERATE"]["GARAGE"], old["GENERATE"]["SCENE"]
    check(cfg, made(old))
    low = copy.deepcopy(old)
    low["GENERATE"]["GARAGE"] = {"ceiling_m": [3.0, 3.4]}
    with pytest.raises(
        RecordError, match=r"GENERATE\.GARAGE\.CEILING_M \[3\.0, 3\.4\], the configuration says \[7\.2, 7\.8"
    ):
        check(cfg, made(low))
    cfg.GENERATE.GARAGE.CEILING_M = [3.0, 3.4]
    check(cfg, made(low))


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("SENSORS.EGO.LIDAR.COLUMNS", 600),
        ("SENSORS.INFRA.CAMERA.Z_M", 2.8),
        ("GENERATE.SCENES", 9),
        ("GENERATE.FRAME_INTERVAL_S", 0.5),
        ("GENERATE.SEED", 1),
        ("GENERATE.GARAGE.CEILING_M", [3.0, 3.4]),
    ],
)
def test_other_data_are_refused_with_key_and_both_values(cfg, path, value):
    *above, last = path.split(".")
    holder = cfg
    for part in above:
        holder = holder[part]
    before, holder[last] = holder.get(last), value
    with pytest.raises(RecordError) as error:
        check(cfg, made())
    assert f"data/dataset.json: these data were made with DATA_CONFIG.{path} {before!r}" in str(error.value)
    assert f"the configuration says {value!r}" in str(error.value) or isinstance(value, dict)


def test_the_arguments_that_the_refusal_names_make_it_pass(cfg):
    """All keys in one go, as a shell hands them to --set; the configuration need not have them."""
    cfg.GENERATE.SCENES, cfg.GENERATE.GARAGE.CEILING_M, cfg.SENSORS.EGO.LIDAR = 9, [3.0, 3.4], None
    data = copy.deepcopy(CFG)
    data["GENERATE"] |= {"SPLIT": {"val": 0.05, "test": 0.0}, "GARAGE_SEED": 7, "MAST": {"HEIGHT_M": [3.0, 4.0]}}
    with pytest.raises(RecordError) as error:
        check(cfg, made(data))
    words = shlex.split(str(error.value).rpartition("(--set ")[2].rpartition(")")[0])
    assert len(words) == 12
    apply_overrides(EasyDict(DATA_CONFIG=cfg), words)
    check(cfg, made(data))


def test_a_seed_on_the_command_line_of_create_data_counts(cfg):
    cfg.GENERATE.SEED = 7
    check(cfg, made(seed=7))
    with pytest.raises(RecordError, match=r"GENERATE\.SEED 0, the configuration says 7"):
        check(cfg, made(seed=8))


def test_recordings_without_a_generator_pass(cfg):
    check(cfg, replace(made(), generator={}))
    cfg.pop("SENSORS")
    cfg.pop("GENERATE")
    check(cfg, made())


def test_the_data_set_class_refuses_and_the_generator_goes_on_with_its_own(cfg, tiny_data, tmp_path):
    cfg.DATA_PATH = str(tiny_data)
    build_dataset(cfg, ["Car"], training=True)
    cfg.SENSORS.EGO.LIDAR.COLUMNS = 600
    for training in (True, False):
        with pytest.raises(RecordError, match=r"SENSORS\.EGO\.LIDAR\.COLUMNS 300, the configuration says 600"):
            build_dataset(cfg, ["Car"], training=training)
    foreign = tmp_path / "foreign"
    shutil.copytree(tiny_data, foreign)
    manifest = json.loads((foreign / "dataset.json").read_text())
    del manifest["generator"]
    (foreign / "dataset.json").write_text(json.dumps(manifest))
    cfg.DATA_PATH = str(foreign)
    assert len(build_dataset(cfg, ["Car"], training=True)) == 4


@pytest.mark.parametrize(
    ("plan", "same"),
    [
        ("/home/a/site.yaml", True),
        ("site.yaml", True),
        ("other.yaml", False),
        ("/home/b/site.yaml", False),
        (None, False),
    ],
)
def test_published_weights_know_a_plan_by_the_name_of_its_file(cfg, plan, same):
    data = copy.deepcopy(CFG)
    data["GENERATE"]["PLAN"], cfg.GENERATE.PLAN = "/home/a/site.yaml", plan
    assert describes(cfg, made(data)) == same
