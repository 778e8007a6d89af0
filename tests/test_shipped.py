"""Files that come with the package: the working folder wins, and an installed package stays as it is."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from pcdet_avp import shipped
from pcdet_avp.config import load_config
from pcdet_avp.errors import ConfigError

REPOSITORY = Path(__file__).parents[1]
SMALL = "cfgs/avp/cp_small.yaml"


@pytest.fixture
def work(tmp_path, monkeypatch):
    """An empty working folder."""
    folder = tmp_path / "work"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """As after ``pip install``: the configurations lie inside the package, below ``_data``; that folder."""
    data = tmp_path / "site" / "pcdet_avp" / "_data"
    shutil.copytree(REPOSITORY / "cfgs", data / "cfgs")
    monkeypatch.setattr(shipped, "ROOT", data)
    monkeypatch.setattr(shipped, "INSTALLED", True)
    return data


def data_path(name):
    return Path(load_config(name).DATA_CONFIG.DATA_PATH)


def test_from_an_empty_folder_the_packages_file_is_found(work):
    assert shipped.find_config(SMALL) == REPOSITORY / SMALL
    assert load_config(SMALL) == load_config(REPOSITORY / SMALL)


def test_a_file_in_the_working_folder_wins(work):
    own = work / SMALL
    own.parent.mkdir(parents=True)
    own.write_text("MINE: 1\n")
    assert load_config(SMALL) == {"MINE": 1}


def test_a_file_of_ones_own_may_build_on_the_packages(work):
    """By the name that the command line takes, or by its place beside the package's files."""
    (work / "mine.yaml").write_text(f"_BASE_CONFIG_: {SMALL}\nMINE: 1\n")
    beside = work / "cfgs" / "avp" / "ablations" / "mine.yaml"
    beside.parent.mkdir(parents=True)
    beside.write_text("_BASE_CONFIG_: ../cp_small.yaml\nMINE: 1\n")
    expected = load_config(REPOSITORY / SMALL) | {"MINE": 1}
    assert load_config("mine.yaml") == load_config(beside) == expected


def test_what_is_nowhere_names_both_places_and_near_ones(work):
    with pytest.raises(ConfigError) as caught:
        load_config("cfgs/avp/cp_smal.yaml")
    places = (f"{folder / 'cfgs' / 'avp' / 'cp_smal.yaml'}" for folder in (work, REPOSITORY))
    assert str(caught.value).startswith(f"cfgs/avp/cp_smal.yaml: there is no file {' or '.join(places)}; near ones: ")
    assert SMALL in str(caught.value)


def test_a_name_leads_nowhere_outside_of_what_is_shipped(work, installed):
    (installed.parent / "secret.yaml").touch()
    assert shipped.places("../secret.yaml") == [work.parent / "secret.yaml"]
    assert shipped.find("../secret.yaml") is None


def test_data_of_a_packaged_configuration_belong_into_the_working_folder(work, installed):
    raw = yaml.safe_load((installed / "cfgs" / "dataset_configs" / "avp_small.yaml").read_text())
    assert raw["DATA_PATH"] == "../../data/avp_small"
    assert data_path(SMALL) == work / "data" / "avp_small"
    assert data_path(installed / SMALL) == work / "data" / "avp_small"
    (work / "mine.yaml").write_text(f"_BASE_CONFIG_: {SMALL}\n")
    assert data_path("mine.yaml") == work / "data" / "avp_small"


def test_data_of_a_checkout_stay_in_the_checkout(work):
    assert data_path(SMALL) == REPOSITORY / "data" / "avp_small"


def test_the_place_is_told_from_where_the_package_lies(installed):
    """In a fresh interpreter that finds the package where pip would have put it."""
    shutil.copytree(
        REPOSITORY / "pcdet_avp", installed.parent, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__py*")
    )
    code = "from pcdet_avp import shipped; print(shipped.INSTALLED, shipped.ROOT)"
    for top, expected in ((installed.parents[1], f"True {installed}"), (REPOSITORY, f"False {REPOSITORY}")):
        done = subprocess.run([sys.executable, "-c", code], cwd=top, capture_output=True, text=True, check=True)
        assert done.stdout.strip() == expected
