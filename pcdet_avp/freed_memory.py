"""Memory that a process frees and needs again a moment later.

Every frame needs the same few hundred megabytes of images, points and maps. Where they go back to the system in between
they come back page by page, and the page faults cost a tenth of the time or more: in the closed loop by glibc's own
rules, in every Dask worker because its nanny asks glibc to return all it can.
"""

from __future__ import annotations

import ctypes
import sys

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of glibc's malloc.h
LARGEST_MMAP_THRESHOLD = 32 << 20  # older versions take no more
KEPT_BYTES = 1 << 30

# The same for processes that are yet to start, and for all their threads: a thread's own arena would still give back
# every 64 MiB that are free.
ENVIRONMENT = {
    "MALLOC_ARENA_MAX": 1,
    "MALLOC_TRIM_THRESHOLD_": KEPT_BYTES,
    "MALLOC_MMAP_THRESHOLD_": LARGEST_MMAP_THRESHOLD,
}


def keep_freed_memory() -> bool:
    """Ask glibc to keep freed memory of up to a gibibyte for this process; whether it will (elsewhere: no)."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    return bool(mallopt(M_MMAP_THRESHOLD, LARGEST_MMAP_THRESHOLD) and mallopt(M_TRIM_THRESHOLD, KEPT_BYTES))
