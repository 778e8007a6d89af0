"""YAML in OpenPCDet's schema: bases, overrides, and one clear error for each mistake."""

import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcdet_avp.config import apply_overrides, config_hash, load_config, require
from pcdet_avp.errors import ConfigError
from pcdet_avp.structures.bev_grid import BevGrid

DATASET_CONFIGS = Path(__file__).parents[1] / "cfgs" / "dataset_configs"


@pytest.fixture
def write(tmp_path):
    def write_file(name, text):
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        return file

    return write_file


def test_bases_are_relative_to_the_file_that_names_them_and_nest(write, monkeypatch):
    write("a/deep/root.yaml", "X: 1\nL: [1, 2, 3]\nD: {P: 1, Q: 1}\n")
    write("a/middle.yaml", "_BASE_CONFIG_: deep/root.yaml\nD: {P: 2}\nY: 5\n")
    top = write("b/top.yaml", "DATA: {_BASE_CONFIG_: ../a/middle.yaml, D: {Q: 9}, L: [7]}\n")
    monkeypatch.chdir("/")
    assert load_config(top) == {"DATA": {"X": 1, "Y": 5, "L": [7], "D": {"P": 2, "Q": 9}}}


def test_attributes_and_keys_are_the_same(write):
    cfg = load_config(write("c.yaml", "A: {LIST: [{NAME: x}]}\n"))
    assert cfg.A.LIST[0].NAME == cfg["A"]["LIST"][0]["NAME"] == "x"


@pytest.mark.parametrize("text", ["1e-3", "1.0e-3", "1E-3", "+.1e-2"])
def test_scientific_notation_is_a_number(write, text):
    assert load_config(write("c.yaml", f"LR: {text}\n")).LR == 0.001


def test_a_relative_data_path_belongs_to_its_own_file(write, tmp_path):
    write("sets/small.yaml", "DATA_PATH: ../data/small\n")
    top = write("models/m.yaml", "DATA_CONFIG: {_BASE_CONFIG_: ../sets/small.yaml}\n")
    path = load_config(top).DATA_CONFIG.DATA_PATH
    assert path == str(tmp_path / "data" / "small")


def test_a_data_path_of_the_command_line_belongs_to_the_working_directory(write, tmp_path, monkeypatch):
    cfg = load_config(write("x/c.yaml", "DATA_PATH: data\n"))
    monkeypatch.chdir(tmp_path)
    path = apply_overrides(cfg, ["DATA_PATH", "here"]).DATA_PATH
    assert path == str(tmp_path / "here")


BROKEN = {
    "A: [1, 2\nB: 3\n": r"c.yaml: broken YAML in line 2",
    "A: 1\nB: 2\nA: 3\n": r"c.yaml: broken YAML in line 3: key 'A' occurs twice",
    "- 1\n": r"c.yaml: expected a mapping at the top, found a list",
    "": r"c.yaml: expected a mapping at the top, found nothing",
    "M: {_BASE_CONFIG_: nowhere.yaml}\n": r"c.yaml: M._BASE_CONFIG_ names 'nowhere.yaml', but there is no file",
    "_BASE_CONFIG_: [a]\n": r"c.yaml: _BASE_CONFIG_ must be the path of a file, found a list",
    "A: &a {B: 1, C: *a}\n": r"c.yaml: broken YAML in line 1: alias \*a of what it lies in has no end",
    "A: 1\nB: &b [[*b]]\n": r"c.yaml: broken YAML in line 2: alias \*b",
    f"A: {'[' * 9999}\n": r"c.yaml: broken YAML: nested too deeply",
    "1: 2\n": r"c.yaml: keys must be text, found 1",
    "A: !!python/object/apply:os.getcwd []\n": r"c.yaml: broken YAML in line 1: could not determine a constructor",
}


@pytest.mark.parametrize("text", BROKEN)
def test_a_broken_file_is_named_with_its_line_or_key(write, text):
    with pytest.raises(ConfigError, match=BROKEN[text]):
        load_config(write("c.yaml", text))


def test_an_alias_stands_for_its_value_wherever_it_is_named(write):
    cfg = load_config(write("c.yaml", "A: &a {B: 1, C: [&n 2, *n]}\nD: *a\nE: {<<: *a, B: 3}\n"))
    assert cfg.D == {"B": 1, "C": [2, 2]}
    assert cfg.E == {"B": 3, "C": [2, 2]}
    with pytest.raises(ConfigError, match=r"--set A.C: .* is not a YAML value"):
        apply_overrides(cfg, ["A.C", "&a [*a]"])


def test_aliases_that_stand_for_more_values_than_anybody_can_walk_through(write):
    """Each line names the one before ten times: 11, 111, 1111, 11111 values are read; 111111 are not."""
    lines = ["A: &A [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]"]
    lines += [f"{name}: &{name} [{', '.join([f'*{before}'] * 10)}]" for before, name in pairwise("ABCDEFGHI")]
    cfg = load_config(write("c.yaml", "\n".join(lines[:4])))
    assert np.array(cfg.D).shape == (10, 10, 10, 10)
    with pytest.raises(ConfigError, match=r"c.yaml: broken YAML in line 5: alias \*D: .* more than 100000 values"):
        load_config(write("c.yaml", "\n".join(lines)))


def test_a_missing_or_unreadable_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"none.yaml: there is no file"):
        load_config(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match="cannot read"):
        load_config(tmp_path)
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match=r"binary.yaml: not UTF-8"):
        load_config(tmp_path / "binary.yaml")


def test_a_circle_of_bases_is_refused(write):
    write("a.yaml", "_BASE_CONFIG_: b.yaml\n")
    b = write("b.yaml", "M: {_BASE_CONFIG_: a.yaml}\n")
    with pytest.raises(ConfigError, match=r"runs in a circle: .*b.yaml -> .*a.yaml -> .*b.yaml"):
        load_config(b)


def test_a_mapping_cannot_be_replaced_by_a_number_but_by_null(write):
    write("base.yaml", "D: {P: 1}\nE: {P: 1}\n")
    with pytest.raises(ConfigError, match=r"c.yaml: D: expected a mapping as in the base file, found an integer"):
        load_config(write("c.yaml", "_BASE_CONFIG_: base.yaml\nD: 3\n"))
    assert load_config(write("c.yaml", "_BASE_CONFIG_: base.yaml\nE: null\n")).E is None


# ---------------------------------------------------------------- overrides


@pytest.fixture
def cfg(write):
    optim = "OPTIM: {LR: 0.003, EPOCHS: 80, AMP: false, NAME: adam, MOMS: [0.95, 0.85]}"
    return load_config(write("c.yaml", f"{optim}\nAUG: [{{NAME: flip, P: 0.5}}]\nOPT: null\n"))


def test_overrides_reach_nested_keys_and_list_items(cfg):
    words = "OPTIM.LR 1e-4 OPTIM.EPOCHS 3 OPTIM.AMP true OPTIM.MOMS.1 0.8 AUG.0.P 1 OPT x"
    apply_overrides(cfg, words.split())
    assert cfg.OPTIM == {"LR": 1e-4, "EPOCHS": 3, "AMP": True, "NAME": "adam", "MOMS": [0.95, 0.8]}
    assert cfg.AUG[0].P == 1.0
    assert type(cfg.AUG[0].P) is float
    assert cfg.OPT == "x"


def test_overrides_take_whole_lists_mappings_and_null(cfg):
    apply_overrides(cfg, ["OPTIM.MOMS", "[0.9, 0.8, 0.7]", "AUG.0", "{P: 0}", "OPTIM.NAME", "null"])
    assert cfg.OPTIM.MOMS == [0.9, 0.8, 0.7]
    assert cfg.AUG[0] == {"NAME": "flip", "P": 0.0}
    assert cfg.OPTIM.NAME is None


def test_text_stays_text_though_it_looks_like_a_number(cfg):
    assert apply_overrides(cfg, ["OPTIM.NAME", "007"]).OPTIM.NAME == "007"


REFUSED = {
    "OPTIM.LRR 1": r"--set OPTIM.LRR: OPTIM has no key 'LRR'; near ones: LR",
    "OPTIMM.LR 1": r"--set OPTIMM.LR: the top level has no key 'OPTIMM'; near ones: OPTIM",
    "ZZZ 1": r"the top level has no key 'ZZZ'; known: OPTIM, AUG, OPT",
    "OPTIM.EPOCHS 1.5": r"--set OPTIM.EPOCHS: expected an integer like the present 80, found a number '1.5'",
    "OPTIM.EPOCHS true": r"expected an integer .* found a boolean",
    "OPTIM.AMP 1": r"expected a boolean .* found an integer",
    "OPTIM.LR fast": r"expected a number like the present 0.003, found text 'fast'",
    "OPTIM.MOMS 0.9": r"expected a list .* found a number",
    "OPTIM.MOMS.2 0.9": r"OPTIM.MOMS is a list of 2 items, '2' is not an index of it",
    "OPTIM.LR.X 1": r"OPTIM.LR is a number, it has no key 'X'",
    "OPTIM.LR [": r"--set OPTIM.LR: '\[' is not a YAML value",
    "OPTIM.LR": r"--set needs pairs of key and value, found 1 words",
}


@pytest.mark.parametrize("words", REFUSED)
def test_a_wrong_override_says_what_would_be_right(cfg, words):
    with pytest.raises(ConfigError, match=REFUSED[words]):
        apply_overrides(cfg, words.split())


def test_an_unknown_key_inside_a_mapping_is_refused_too(cfg):
    with pytest.raises(ConfigError, match=r"--set AUG.0.Q: AUG.0 has no key 'Q'; known: NAME, P"):
        apply_overrides(cfg, ["AUG.0", "{Q: 1}"])


# ---------------------------------------------------------------- require and hash


def test_require_names_what_is_missing_or_of_another_type(cfg):
    assert require(cfg, "OPTIM.LR", float) == 0.003
    with pytest.raises(ConfigError, match=r"missing key OPTIM.EPOCH; near ones: EPOCHS"):
        require(cfg, "OPTIM.EPOCH")
    with pytest.raises(ConfigError, match=r"OPTIM.AMP must be int, found False"):
        require(cfg, "OPTIM.AMP", int)
    with pytest.raises(ConfigError, match=r"OPTIM.NAME must be int or float, found 'adam'"):
        require(cfg, "OPTIM.NAME", (int, float))


def test_the_hash_follows_values_not_order_nor_place(write):
    one = load_config(write("a/c.yaml", "A: 1\nB: {DATA_PATH: d, C: [1, 2]}\n"))
    other = load_config(write("b/c.yaml", "B: {C: [1, 2], DATA_PATH: e}\nA: 1\n"))
    assert config_hash(one) == config_hash(other)
    assert config_hash(apply_overrides(other, ["B.C.1", "3"])) != config_hash(one)


def test_a_limit_on_bytes_counts_only_where_there_is_one():
    codec = {"NAME": "BevCodec"}
    unlimited = config_hash({"COMPRESSION": codec | {"MAX_BYTES": None, "CONSTANT_SIZE": False}})
    assert unlimited == config_hash({"COMPRESSION": codec})
    limited = config_hash({"COMPRESSION": codec | {"MAX_BYTES": 1475, "CONSTANT_SIZE": False}})
    filled = config_hash({"COMPRESSION": codec | {"MAX_BYTES": 1475, "CONSTANT_SIZE": True}})
    assert len({unlimited, limited, filled}) == 3


values = st.recursive(
    st.none() | st.booleans() | st.integers(-9, 9) | st.floats(allow_nan=False) | st.text("ab", max_size=3),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text("AB", min_size=1, max_size=2), inner, max_size=3)
    ),
    max_leaves=6,
)


@given(a=values, b=values)
def test_equal_hashes_mean_equal_configurations(a, b):
    assert (config_hash({"K": a}) == config_hash({"K": b})) == (repr(sort(a)) == repr(sort(b)))


def sort(value):
    if isinstance(value, dict):
        return {key: sort(value[key]) for key in sorted(value)}
    return [sort(item) for item in value] if isinstance(value, list) else value


# ---------------------------------------------------------------- the data set configurations that we ship

SHIPPED = {"avp_full": (376, 280, 2240), "avp_small": (188, 140, 1200), "avp_tiny": (94, 70, 16)}


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_data_set_has_a_whole_grid_and_its_number_of_frames(name):
    cfg = load_config(DATASET_CONFIGS / f"{name}.yaml")
    grid = BevGrid.from_range(cfg.POINT_CLOUD_RANGE, cfg.VOXEL_SIZE)
    frames = cfg.GENERATE.SCENES * cfg.GENERATE.FRAMES_PER_SCENE
    assert (grid.height, grid.width, frames) == SHIPPED[name]
    assert os.path.basename(cfg.DATA_PATH) == name
    for agent in ("EGO", "INFRA"):
        camera = cfg.SENSORS[agent].CAMERA
        assert [camera.HEIGHT, camera.WIDTH] == cfg.IMAGE_SHAPE


def test_the_full_sensors_are_the_papers():
    sensors = load_config(DATASET_CONFIGS / "avp_full.yaml").SENSORS
    ego, infra = sensors.EGO, sensors.INFRA
    assert (ego.CAMERA.WIDTH, ego.CAMERA.HEIGHT, ego.CAMERA.HFOV_DEG, ego.CAMERA.Z_M) == (960, 540, 90, 1.8)
    assert (infra.CAMERA.Z_M, infra.CAMERA.PITCH_DOWN_DEG, infra.LIDAR.Z_M) == (7.0, 30, 7.0)
    steps_deg = [agent.LIDAR.AZIMUTH_SPAN_DEG / agent.LIDAR.COLUMNS for agent in (ego, infra)]
    assert steps_deg == pytest.approx([0.06, 0.02])
    assert (ego.LIDAR.ELEVATION_MIN_DEG, ego.LIDAR.ELEVATION_MAX_DEG) == (-24.8, 2)
    assert (infra.LIDAR.ELEVATION_MIN_DEG, infra.LIDAR.ELEVATION_MAX_DEG) == (-60, 30)
    assert ego.LIDAR.DROP_OFF == infra.LIDAR.DROP_OFF == 0.1
