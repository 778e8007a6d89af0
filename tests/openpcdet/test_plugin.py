"""register() and the runner, against tables like OpenPCDet's."""

import subprocess
import sys
import types
from pathlib import Path

import pytest

from pcdet_avp.errors import PluginError
from pcdet_avp.plugin import find_configs, our_classes, register

REPOSITORY = Path(__file__).parents[2]
TABLES = list(our_classes())


@pytest.fixture
def tables(monkeypatch):
    """A package ``pcdet`` with tables that hold what OpenPCDet's own hold."""
    for name in {".".join(table.split(".")[: i + 1]) for table in TABLES for i in range(len(table.split(".")))}:
        module = types.ModuleType(name)
        module.__path__ = []
        monkeypatch.setitem(sys.modules, name, module)
    for table in TABLES:
        sys.modules[table].__all__ = {"BaseBEVBackbone": dict}
    return {table: sys.modules[table].__all__ for table in TABLES}


def test_all_classes_are_entered_and_twice_is_once(tables):
    first = register()
    before = {table: dict(content) for table, content in tables.items()}
    assert register() == first
    assert before == tables
    assert tables["pcdet.datasets"]["AvpDataset"].__name__ == "OpenPCDetAvpDataset"
    assert tables["pcdet.models.backbones_2d"]["BaseBEVBackbone"] is dict
    assert sum(len(names) for names in first.values()) == 11


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
                (package / "__init__.py").write_text("__all__ = {}\n")
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
