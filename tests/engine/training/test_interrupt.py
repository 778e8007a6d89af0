"""Ctrl-C waits for the end of a step; the impatient need not."""

import os
import signal

import pytest

from pcdet_avp.engine.training import interrupt
from pcdet_avp.engine.training.interrupt import Interrupt


def test_the_first_signal_only_asks_and_its_echo_changes_nothing():
    with Interrupt() as asked:
        assert not asked.requested
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGTERM)
        assert asked.requested


@pytest.mark.parametrize("speaks", [False, True])
def test_it_says_once_what_the_signal_does(capfd, speaks):
    with Interrupt(speaks):
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
    assert capfd.readouterr().err.count("stopping after this iteration") == speaks


def test_a_later_second_ctrl_c_interrupts_at_once(monkeypatch):
    monkeypatch.setattr(interrupt, "PATIENCE_S", -1.0)

    def twice():
        with Interrupt():
            os.kill(os.getpid(), signal.SIGINT)
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        twice()


def test_afterwards_signals_mean_what_they_did_before():
    before = signal.getsignal(signal.SIGINT)
    with Interrupt():
        assert signal.getsignal(signal.SIGINT) is not before
    assert signal.getsignal(signal.SIGINT) is before
