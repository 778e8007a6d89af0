"""How a tool ends: one line and a status for what a user can cause, a traceback for what is our fault."""

import pytest

from pcdet_avp.cli import run_tool
from pcdet_avp.errors import ConfigError


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


def test_any_other_system_error_keeps_its_traceback():
    with pytest.raises(SystemError, match="ours"):
        run_tool(raising(SystemError("ours"), ValueError("something else")))


def test_wrong_input_is_one_line(capsys):
    with pytest.raises(SystemExit) as end:
        run_tool(raising(ConfigError("a: expected 1, found 2")))
    assert end.value.code == 2
    assert capsys.readouterr().err == "error: a: expected 1, found 2\n"
