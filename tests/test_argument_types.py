"""Numbers and paths of the command line: what cannot be meant is one line before anything starts."""

import argparse
import importlib
import os
import sys
from pathlib import Path

import pytest

from pcdet_avp import argument_types as types
from pcdet_avp.argument_types import Parser
from pcdet_avp.errors import ConfigError


@pytest.mark.parametrize(
    ("kind", "good", "bad"),
    [
        ("positive_int", {"1": 1, "30": 30}, ["0", "-1", "1.5", "", "one", "nan", "1e3"]),
        ("non_negative_int", {"0": 0, "2": 2}, ["-1", "0.0", "x"]),
        ("positive_float", {"0.5": 0.5, "1e-3": 0.001}, ["0", "-2", "nan", "inf", "-inf", "x", ""]),
        ("non_negative_float", {"0": 0.0, "2.5": 2.5}, ["-0.1", "nan", "inf"]),
        ("tag", {"night": "night", "a/b": "a/b"}, ["", " ", ".", "..", "../x", "a/../../x", "/tmp/x"]),
        ("share", {"0": 0.0, "1": 1.0}, ["-0.01", "1.01", "nan"]),
    ],
)
def test_a_number_is_taken_or_refused_by_name(kind, good, bad):
    parser = Parser(prog="tool")
    parser.add_argument("--option", type=getattr(types, kind))
    for text, value in good.items():
        assert parser.parse_args(["--option", text]).option == value
    for text in bad:
        with pytest.raises(ConfigError, match=r"argument --option: expected .*; tool --help lists the arguments"):
            parser.parse_args([f"--option={text}"])


def test_a_tilde_is_a_home_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert types.path("~/a/b.pth") == tmp_path / "a" / "b.pth"
    assert types.path("a~b") == Path("a~b")
    assert types.path_text("~") == str(tmp_path)
    for text in ("", "~nobody_of_this_name/x"):
        with pytest.raises(argparse.ArgumentTypeError):
            types.path(text)


def test_every_tool_expands_paths_and_bounds_its_numbers():
    """No tool takes a bare ``int``, ``float`` or ``Path``: each number and path has a type of this module."""
    folder = Path(types.__file__).parent / "commands"
    for file in sorted(folder.glob("*.py")):
        for line in file.read_text().splitlines():
            for bare in ("type=int,", "type=float,", "type=Path,"):
                assert bare not in line or "choices=" in line, f"{file.name}: {line.strip()}"
    assert os.listdir(folder)


@pytest.mark.parametrize(
    ("tool", "words", "message"),
    [
        ("demo", ["--columns", "5"], "--columns: belongs to --data_path"),
        ("demo", ["--lidar_height_m", "0"], "--lidar_height_m: belongs to --data_path"),
        ("demo", ["--data_path", "a.bin", "--frame", "a/0"], "--data_path and --frame: give one of them"),
        ("demo", ["--frame", "a/0", "--pictures", "3"], "--frame and --pictures: give one of them"),
        ("demo", ["--pictures", "3", "--frames", "5"], "--pictures and --frames: give one of them"),
        ("test", ["--start_epoch", "3"], "--start_epoch: belongs to --eval_all"),
        ("test", ["--eval_all", "--ckpt", "a.pth"], "--eval_all and --ckpt: give one of them"),
        ("test", ["--eval_all", "--json", "a.json"], "--eval_all and --json: give one of them"),
        ("test", ["--ckpt_dir", "runs", "--ckpt", "a.pth"], "--ckpt_dir and --ckpt: give one of them"),
    ],
)
def test_an_option_that_would_be_ignored_is_refused(tool, words, message, monkeypatch):
    module = importlib.import_module(f"pcdet_avp.commands.{tool}")
    monkeypatch.setattr(sys, "argv", [tool, "--cfg", "c.yaml", *words])
    with pytest.raises(ConfigError, match=message):
        module.parse_arguments()


@pytest.mark.parametrize(
    ("tool", "words"),
    [
        ("demo", []),
        ("demo", ["--data_path", "a.bin", "--columns", "5", "--intensity_scale", "255", "--lidar_height_m", "0"]),
        ("demo", ["--frames", "5", "--split", "val"]),
        ("test", ["--eval_all", "--start_epoch", "0", "--ckpt_dir", "runs"]),
        ("test", ["--ckpt", "a.pth", "--json", "a.json"]),
    ],
)
def test_options_that_belong_together_are_taken(tool, words, monkeypatch):
    module = importlib.import_module(f"pcdet_avp.commands.{tool}")
    monkeypatch.setattr(sys, "argv", [tool, "--cfg", "c.yaml", *words])
    assert module.parse_arguments().cfg == "c.yaml"
