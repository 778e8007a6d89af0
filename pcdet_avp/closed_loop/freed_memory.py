"""Memory that a process frees and needs again a moment later."""

from __future__ import annotations

import ctypes
import sys

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of glibc's malloc.h
LARGEST_MMAP_THRESHOLD = 32 << 20  # older versions take no more
KEPT_BYTES = 1 << 30


def keep_freed_memory() -> bool:
    """Ask glibc to keep freed memory of up to a gibibyte for the process; whether it will (elsewhere: no).

    Every tick the loop needs the same few hundred megabytes of images and maps. By default they go back to the system
    and come back page by page: ten thousand page faults and a tenth of the time.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    return bool(mallopt(M_MMAP_THRESHOLD, LARGEST_MMAP_THRESHOLD) and mallopt(M_TRIM_THRESHOLD, KEPT_BYTES))
