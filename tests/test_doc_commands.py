"""Every command line of README and of the pages under docs/ is one that its tool understands."""

import re
import shlex
import sys
from importlib import import_module
from pathlib import Path

import pytest

from pcdet_avp.errors import ConfigError

ROOT = Path(__file__).parents[1]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md")])
BLOCK = re.compile(r"^ *```\w*\n(.*?)^ *```", re.DOTALL | re.MULTILINE)
COMMAND = re.compile(r"^ *(?:torchrun [-\w ]*?|python )?(?:tools/(\w+)\.py|(avp-[a-z]+)) (.*)$", re.MULTILINE)
VARIABLE = re.compile(r"^ *([A-Z]+)=(\"[^\"]*\"|\S+)", re.MULTILINE)


def scripts():
    """{avp-data: create_data} of the installed commands."""
    entry = r'^(avp-[a-z]+) = "pcdet_avp\.commands\.(\w+):run"$'
    return dict(re.findall(entry, (ROOT / "pyproject.toml").read_text(), re.MULTILINE))


def commands(text):
    """(tool, words) of every command in the code blocks of a page, shell variables put in."""
    for block in BLOCK.findall(text):
        variables = {name: value.strip('"') for name, value in VARIABLE.findall(block)}
        for tool, installed, rest in COMMAND.findall(block.replace("\\\n", " ")):
            if "..." in rest:  # the page leaves something out
                continue
            for _ in range(2):  # a variable may hold another one
                rest = re.sub(r"\$([A-Z]+)", lambda found, of=variables: of.get(found[1], found[0]), rest)
            yield tool or scripts()[installed], shlex.split(rest, comments=True)


def problem(monkeypatch, tool, words):
    """What the tool says to a command line; None if it takes it."""
    monkeypatch.setattr(sys, "argv", [f"{tool}.py", *words])
    try:
        import_module(f"pcdet_avp.commands.{tool}").parse_arguments()
    except ConfigError as error:
        return f"{tool}.py {shlex.join(words)}: {error}"
    return None


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_tools_understand_the_commands_of_a_page(page, monkeypatch):
    found = [problem(monkeypatch, *command) for command in commands(page.read_text())]
    assert [each for each in found if each] == []


def test_the_commands_are_found():
    assert sum(len(list(commands(page.read_text()))) for page in PAGES) > 50


def test_a_flag_that_is_no_more_is_noticed(monkeypatch):
    page = 'text\n```\nCFG="--cfg a.yaml"\npython tools/test.py $CFG --no_such_flag \\\n    --wire    # why\n```\n'
    ((tool, words),) = commands(page)
    assert (tool, words) == ("test", ["--cfg", "a.yaml", "--no_such_flag", "--wire"])
    assert "no_such_flag" in problem(monkeypatch, tool, words)
