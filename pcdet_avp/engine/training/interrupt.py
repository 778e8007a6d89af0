"""Ctrl-C at any moment, obeyed between two iterations."""

from __future__ import annotations

import os
import signal
import threading
import time
from types import FrameType

STDERR = 2
NOTICE = b"\nstopping after this iteration, with a checkpoint; Ctrl-C again stops at once, without\n"
SIGNALS = (signal.SIGINT, signal.SIGTERM)
PATIENCE_S = 1.0  # a launcher repeats the terminal's signal at once; only a later one is impatience


class Interrupt:
    """While active, the first Ctrl-C (or SIGTERM) only sets ``requested``; a second Ctrl-C interrupts at once.

    ``speaks``: it tells the user, since an iteration may take minutes.
    """

    def __init__(self, speaks: bool = False) -> None:
        self.requested, self.speaks = False, speaks
        self._since = 0.0
        self._before: dict[int, object] = {}

    def __enter__(self) -> Interrupt:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._note) for number in SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if not self.requested:
            self.requested, self._since = True, now
            if self.speaks:
                os.write(STDERR, NOTICE)  # a signal handler must not enter a stream that may be in use
        elif number == signal.SIGINT and now - self._since > PATIENCE_S:
            raise KeyboardInterrupt
