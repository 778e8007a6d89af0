"""Worker processes that end when the process that they work for does, however that ended. Imports no torch."""

from __future__ import annotations

import multiprocessing
import os
import threading
import time

ORPHANED = 1  # exit status
LOOK_EVERY_S = 1.0


def end_with_parent(look_every_s: float = LOOK_EVERY_S) -> None:
    """To be called in a worker: it exits, in whatever it is busy or stuck, once its parent is gone.

    PyTorch's data workers notice that, too, but then wait for the batch that is on its way: one that does not fit into
    a pipe, which nobody reads any more, keeps the worker and its memory for ever (torch 2.13.0, after ``kill -9``).
    """
    parent, started_by = os.getppid(), multiprocessing.parent_process()
    if started_by is not None and not started_by.is_alive():  # it was quicker: the parent is another one already
        os._exit(ORPHANED)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(look_every_s)
        os._exit(ORPHANED)

    threading.Thread(target=watch, name="end with parent", daemon=True).start()
