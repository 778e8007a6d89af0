"""Keeps numba's cache honest about kernels that inline helpers and constants of other modules.

numba renews a cached kernel when the kernel's own file changes, and only then. A kernel that takes
``sources=fingerprint(module, ...)`` as an argument nobody passes is compiled anew when one of the modules does,
because the value of a default is part of the signature that numba caches by.
"""

from __future__ import annotations

import inspect
import zlib
from types import ModuleType


def fingerprint(*modules: ModuleType) -> int:
    """A checksum of the modules' source text."""
    return zlib.crc32("".join(inspect.getsource(module) for module in modules).encode())
