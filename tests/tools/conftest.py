"""Tools called in this process, in a working directory of their own."""

import importlib
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
CFG = str(REPOSITORY / "cfgs" / "avp" / "cp_tiny.yaml")


@pytest.fixture(scope="session")
def load_tool():
    """``load_tool(name)``: the module that tools/<name>.py runs."""
    return lambda name: importlib.import_module(f"pcdet_avp.commands.{name}")


@pytest.fixture(scope="session")
def call(load_tool, tiny_data):
    """``call(folder, tool, *arguments)``: run a tool's main on cp_tiny and the tiny data, in ``folder``."""

    def run(folder, name, *arguments, data=tiny_data, overrides=()):
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            workers = () if name == "demo" else ("--workers", 0)
            words = [name, "--cfg", CFG, *workers, *arguments, "--set", "DATA_CONFIG.DATA_PATH", data, *overrides]
            patch.setattr(sys, "argv", [str(word) for word in words])
            load_tool(name).main()

    return run


@pytest.fixture(scope="session")
def trained(call, tmp_path_factory):
    """A working directory in which cp_tiny was trained for two epochs; the run's folder in it."""
    folder = tmp_path_factory.mktemp("trained")
    call(folder, "train", "--epochs", 2, "--picture_interval", 2, "--logger_iter_interval", 1)
    return folder / "output" / "avp" / "cp_tiny" / "default"
