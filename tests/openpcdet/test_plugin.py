"""register() and the runner, against tables like OpenPCDet's."""

import logging
import pickle
import subprocess
import sys
import types
from pathlib import Path

import pytest
import torch

from pcdet_avp.config import load_config
from pcdet_avp.errors import CheckpointError, PluginError
from pcdet_avp.models.weights.agreement import meaning_in
from pcdet_avp.models.weights.checkpoint_file import read_checkpoint
from pcdet_avp.models.weights.meaning import differences, meaning_of
from pcdet_avp.plugin import find_configs, our_classes, register

REPOSITORY = Path(__file__).parents[2]
TABLES = list(our_classes())
REGISTERED = "pcdet_avp.plugin_classes"
# Of a package of OpenPCDet; torch.nn stands for what its templates derive from.
PACKAGE = """
import torch
__all__ = {}
class DatasetTemplate(torch.utils.data.Dataset): pass
class Detector3DTemplate(torch.nn.Module): pass
"""
CFG = REPOSITORY / "cfgs" / "avp" / "cp_tiny.yaml"


class DatasetTemplate(torch.utils.data.Dataset):
    """As much of OpenPCDet's class of this name as others rely on."""

    def __init__(self, dataset_cfg=None, class_names=None, training=True, root_path=None, logger=None):
        raise AssertionError("it would read keys that our configurations do not have")

    @property
    def mode(self):
        return "train" if self.training else "test"

    def __getstate__(self):
        state = dict(self.__dict__)
        del state["logger"]
        return state

    def __setstate__(self, state):
        self.__dict__.update(state)

    def merge_all_iters_to_one_epoch(self, merge=True, epochs=None):
        self.total_epochs = epochs


class Detector3DTemplate(torch.nn.Module):
    """As much of OpenPCDet's class of this name as others rely on."""

    def __init__(self, model_cfg, num_class, dataset):
        raise AssertionError("it would build parts of its own")

    @property
    def mode(self):
        return "TRAIN" if self.training else "TEST"

    def post_processing(self, batch_dict):
        raise AssertionError("ours was asked for")

    def load_params_from_file(self, filename, logger, to_cpu=False, pre_trained_path=None):
        raise AssertionError("ours was asked for")


@pytest.fixture
def tables(monkeypatch):
    """A package ``pcdet`` with tables that hold what OpenPCDet's own hold."""
    for name in {".".join(table.split(".")[: i + 1]) for table in TABLES for i in range(len(table.split(".")))}:
        module = types.ModuleType(name)
        module.__path__ = []
        monkeypatch.setitem(sys.modules, name, module)
    for table in TABLES:
        sys.modules[table].__all__ = {"BaseBEVBackbone": dict}
    sys.modules["pcdet.datasets"].DatasetTemplate = DatasetTemplate
    sys.modules["pcdet.models.detectors"].Detector3DTemplate = Detector3DTemplate
    monkeypatch.delitem(sys.modules, REGISTERED, raising=False)  # it holds classes of another test's package
    return {table: sys.modules[table].__all__ for table in TABLES}


def test_all_classes_are_entered_and_twice_is_once(tables):
    first = register()
    before = {table: dict(content) for table, content in tables.items()}
    assert register() == first
    assert before == tables
    assert tables["pcdet.datasets"]["AvpDataset"].__name__ == "RegisteredAvpDataset"
    assert tables["pcdet.models.backbones_2d"]["BaseBEVBackbone"] is dict
    assert first.keys() == our_classes().keys()
    for table, names in first.items():
        assert set(names) <= set(tables[table])


def test_a_taken_name_is_named_and_nothing_is_entered(tables):
    tables["pcdet.models.backbones_2d.fuser"]["AdaFusion"] = list
    before = {table: dict(content) for table, content in tables.items()}
    with pytest.raises(PluginError, match=r"backbones_2d\.fuser\.__all__\['AdaFusion'\] is builtins\.list; nothing"):
        register()
    assert before == tables


def test_a_table_that_is_none_is_not_taken_for_openpcdet(tables):
    sys.modules["pcdet.datasets"].__all__ = ["KittiDataset"]
    with pytest.raises(PluginError, match=r"pcdet\.datasets\.__all__: expected OpenPCDet's table .* found list"):
        register()


def test_an_openpcdet_that_cannot_be_imported_says_which_part_is_missing(tables, monkeypatch):
    monkeypatch.delitem(sys.modules, "pcdet.models.detectors")
    with pytest.raises(PluginError, match=r"OpenPCDet cannot be imported: .*'pcdet\.models\.detectors'"):
        register()


def test_without_openpcdet_it_says_so_in_one_line(tmp_path):
    done = run("-m", "pcdet_avp.plugin", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "error: OpenPCDet is not installed here: Python finds no package 'pcdet'\n"


def run(*words, cwd):
    environment = {"PYTHONPATH": str(REPOSITORY), "PATH": ""}
    command = [sys.executable, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd, env=environment)


def test_the_runner_hands_over_to_a_script_of_a_checkout_that_is_not_installed(tmp_path):
    """The script finds its neighbours, our class in the table, its arguments, and our configuration."""
    for table in TABLES:
        folder = tmp_path.joinpath(*table.split("."))
        folder.mkdir(parents=True, exist_ok=True)
        for package in (folder, *folder.parents):
            if tmp_path in package.parents and not (package / "__init__.py").exists():
                (package / "__init__.py").write_text(PACKAGE)
    (tmp_path / "tools").mkdir()
    (tmp_path / "tools" / "neighbour.py").write_text("WORD = 'seen'\n")
    (tmp_path / "tools" / "train.py").write_text(
        "import sys, neighbour, pcdet.datasets\n"
        "if __name__ == '__main__':\n"
        "    print(neighbour.WORD, *pcdet.datasets.__all__, *sys.argv)\n"
    )
    words = ["--cfg_file", "cfgs/openpcdet/cp_tiny.yaml", "--epochs", "1"]
    done = run("-m", "pcdet_avp.plugin", tmp_path / "tools" / "train.py", *words, cwd=tmp_path)
    assert done.stderr == ""
    config = str(REPOSITORY / "cfgs" / "openpcdet" / "cp_tiny.yaml")
    expected = ["seen", "AvpDataset", str(tmp_path / "tools" / "train.py"), "--cfg_file", config, "--epochs", "1"]
    assert done.stdout.split() == expected


def test_a_missing_script_is_one_line(tmp_path):
    done = run("-m", "pcdet_avp.plugin", "train.py", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        "error: train.py: no such script; expected OpenPCDet's tools/train.py, tools/test.py or the like"
    ]


def test_a_configuration_in_the_working_directory_comes_first(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = "cfgs/openpcdet/cp_small.yaml"
    assert find_configs([name, "other.yaml"]) == [str(REPOSITORY / name), "other.yaml"]
    (tmp_path / name).parent.mkdir(parents=True)
    (tmp_path / name).touch()
    assert find_configs([name]) == [name]


@pytest.fixture
def build(tables, tiny_data):
    """``build(training)``: data set and detector out of OpenPCDet's tables, by its calls."""
    register()
    cfg = load_config(CFG)
    cfg.DATA_CONFIG.DATA_PATH = str(tiny_data)

    def build(training=False, **changes):
        cfg.update(changes)
        how = {"dataset_cfg": cfg.DATA_CONFIG, "class_names": cfg.CLASS_NAMES, "root_path": None, "logger": None}
        dataset = tables["pcdet.datasets"]["AvpDataset"](**how, training=training)
        cls = tables["pcdet.models.detectors"]["AvpCp"]
        return dataset, cls(model_cfg=cfg.MODEL, num_class=len(cfg.CLASS_NAMES), dataset=dataset)

    return build


def test_what_is_registered_is_of_the_hosts_kinds_and_computes_as_ours(build):
    dataset, network = build()
    assert isinstance(dataset, DatasetTemplate)
    assert isinstance(network, Detector3DTemplate)
    assert (dataset.mode, network.eval().mode, network.train().mode) == ("test", "TEST", "TRAIN")
    assert (network.num_class, network.class_names, network.dataset) == (2, ["Car", "Pedestrian"], dataset)
    batch = {
        k: torch.from_numpy(v).float() if getattr(v, "dtype", None) == "float32" else v
        for k, v in dataset.collate_batch([dataset[0]]).items()
    }
    batch["source_present"] = torch.from_numpy(batch["source_present"]).float()
    with torch.no_grad():
        found, _ = network.eval()(batch)
    assert set(found[0]) == {"pred_boxes", "pred_scores", "pred_labels"}


def test_other_processes_find_what_is_registered_by_name(build):
    dataset, _ = build(training=True)
    there = pickle.loads(pickle.dumps(dataset))
    assert type(there) is type(dataset)
    assert there[(0, "C+none", 3)]["frame_id"] == dataset[0, "C+none", 3]["frame_id"]


def test_a_mode_of_the_template_that_would_do_nothing_is_refused(build):
    with pytest.raises(PluginError, match="--merge_all_iters_to_one_epoch"):
        build(training=True)[0].merge_all_iters_to_one_epoch(merge=True, epochs=3)


def test_a_host_without_its_templates_is_refused(tables, monkeypatch):
    monkeypatch.delattr(sys.modules["pcdet.datasets"], "DatasetTemplate")
    with pytest.raises(PluginError, match=r"OpenPCDet cannot be imported: .*DatasetTemplate"):
        register()


def test_checkpoints_that_the_host_writes_say_what_their_weights_mean(build, tmp_path):
    """It writes tensors alone, each brought to the CPU; ours read it, and refuse another order of classes."""
    _, network = build()
    state = {name: value.cpu() for name, value in network.state_dict().items()}
    torch.save({"epoch": 1, "it": 2, "model_state": state, "optimizer_state": None}, tmp_path / "host.pth")
    content = read_checkpoint(tmp_path / "host.pth")
    assert differences(meaning_in(content), meaning_of(load_config(CFG))) == []
    assert not [name for name in content["model_state"] if "extra_state" in name]
    _, other = build()
    other.load_params_from_file(filename=tmp_path / "host.pth", logger=logging.getLogger("host"), to_cpu=True)
    other.load_state_dict(state)
    _, swapped = build(CLASS_NAMES=["Pedestrian", "Car"])
    with pytest.raises(CheckpointError, match=r"CLASS_NAMES is \['Car', 'Pedestrian'\] in the file"):
        swapped.load_params_from_file(filename=tmp_path / "host.pth", logger=logging.getLogger("host"), to_cpu=True)
    with pytest.raises(CheckpointError, match="CLASS_NAMES"):
        swapped.load_state_dict(state)
