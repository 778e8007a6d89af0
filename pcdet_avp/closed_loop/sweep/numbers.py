"""Averages of a sweep's figures, and their text."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

NOTHING = "-"  # in a table: there was nothing to measure


def finite_mean(values: Iterable[float | None]) -> float | None:
    """The mean of the values that are there and finite; None where there are none."""
    found = [value for value in values if value is not None and np.isfinite(value)]
    return float(np.mean(found)) if found else None


def table_text(value: float | None, factor: float = 1.0) -> str:
    """``factor`` times the value with one decimal."""
    return NOTHING if value is None else f"{factor * value:.1f}"


def csv_text(value: Any) -> str:
    """Empty where nothing was measured; six digits of a real number."""
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
