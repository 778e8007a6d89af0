"""How a tool ends: one line and a status for what a user can cause, a traceback for what is our fault."""

import subprocess
import sys

import pytest

from pcdet_avp.cli import run_tool
from pcdet_avp.errors import ConfigError
from pcdet_avp.files import check_writable, make_folder, write_text


def raising(error, cause=None):
    def main():
        raise error from cause

    return main


@pytest.mark.parametrize("cause", [None, SystemError("in another kernel")])
def test_an_interrupt_inside_compiled_code_is_an_interrupt(capsys, cause):
    """numba's dispatcher returns with the exception set, of which Python makes a SystemError."""
    inner = KeyboardInterrupt()
    if cause is not None:
        cause.__cause__, inner = inner, cause
    with pytest.raises(SystemExit) as end:
        run_tool(raising(SystemError("returned a result with an exception set"), inner))
    assert end.value.code == 130
    assert capsys.readouterr().err == "interrupted; the same command goes on from here\n"


WRITES = """
import sys, time
from pathlib import Path
sys.path[:0] = {path!r}
from pcdet_avp.cli import run_tool
from pcdet_avp.files import replacing

def main():
    with replacing(Path({file!r})) as aside:
        aside.write_text("half")
        print("begun", flush=True)
        time.sleep(60)

run_tool(main)
"""


def test_a_tool_that_is_terminated_leaves_nothing_half_written(tmp_path):
    """SIGTERM: ``kill``, a batch system whose time is up, a container that is stopped."""
    code = WRITES.format(path=sys.path, file=str(tmp_path / "result.json"))
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as tool:
        assert tool.stdout.readline() == b"begun\n"
        tool.terminate()
        assert tool.wait(60) == 130
        assert tool.stderr.read() == b"interrupted; the same command goes on from here\n"
    assert list(tmp_path.iterdir()) == []


def test_any_other_system_error_keeps_its_traceback():
    with pytest.raises(SystemError, match="ours"):
        run_tool(raising(SystemError("ours"), ValueError("something else")))


def test_wrong_input_is_one_line(capsys):
    with pytest.raises(SystemExit) as end:
        run_tool(raising(ConfigError("a: expected 1, found 2")))
    assert end.value.code == 2
    assert capsys.readouterr().err == "error: a: expected 1, found 2\n"


def test_an_error_leaves_no_empty_folder_behind_and_removes_nothing_else(tmp_path):
    """A mistyped tag: the folders made for its results go, those of others and those with a file stay."""
    (tmp_path / "output" / "theirs").mkdir(parents=True)

    def main():
        make_folder(tmp_path / "output" / "mistyped" / "ckpt")
        check_writable(tmp_path / "output" / "results" / "a.json")
        write_text(tmp_path / "output" / "begun" / "log", "1 frame")
        raise ConfigError("no checkpoint")

    with pytest.raises(SystemExit):
        run_tool(main)
    assert sorted(path.name for path in (tmp_path / "output").iterdir()) == ["begun", "theirs"]
