"""tools/*.py and the console scripts are two doors to the same commands."""

import importlib
import re
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from pcdet_avp import cli, commands, shipped

REPOSITORY = Path(__file__).parents[2]
TOOLS = sorted((REPOSITORY / "tools").glob("*.py"))
SCRIPTS = dict(
    re.findall(r'^(avp-\w+) = "pcdet_avp\.commands\.(\w+):run"$', (REPOSITORY / "pyproject.toml").read_text(), re.M)
)


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.stem)
def test_a_tool_names_its_command_lines_and_runs_the_command_of_its_name(tool, monkeypatch):
    text, called = tool.read_text(), []
    module = importlib.import_module(f"pcdet_avp.commands.{tool.stem}")
    monkeypatch.setattr(module, "run", lambda: called.append(tool.stem))
    exec(compile(text, tool, "exec"), {"__name__": "__main__"})
    assert called == [tool.stem]
    assert f"python tools/{tool.name}" in text
    assert len(text.splitlines()) <= 20


def test_every_command_has_a_tool_and_every_script_a_command():
    found = {file.stem for file in Path(commands.__file__).parent.glob("*.py")} - {"__init__"}
    assert found == {tool.stem for tool in TOOLS}
    assert set(SCRIPTS.values()) <= found
    assert {"avp-export", "avp-data", "avp-train", "avp-test", "avp-demo", "avp-safety", "avp-tour"} <= set(SCRIPTS)


@pytest.mark.parametrize("name", sorted(SCRIPTS))
def test_a_script_ends_as_a_program_should(name, monkeypatch, capsys):
    """As its entry point calls it: help is printed, wrong input is one line and status 2."""
    module = importlib.import_module(f"pcdet_avp.commands.{SCRIPTS[name]}")
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    with pytest.raises(SystemExit) as ended:
        module.run()
    assert ended.value.code == 0
    assert f"usage: {name}" in capsys.readouterr().out


def test_the_words_of_a_command_are_those_that_work_here(monkeypatch):
    assert cli.program("train") == ["python", "tools/train.py"]
    scripts = [
        EntryPoint(name, f"pcdet_avp.commands.{module}:run", "console_scripts") for name, module in SCRIPTS.items()
    ]
    monkeypatch.setattr(shipped, "INSTALLED", True)
    monkeypatch.setattr(cli, "entry_points", lambda group: scripts)
    assert cli.program("train") == ["avp-train"]
    assert cli.program("publish_weights") == ["python", "-m", "pcdet_avp.commands.publish_weights"]
