"""Numbers and paths of the command line: what cannot be meant is one line before anything starts."""

import argparse
import os
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
