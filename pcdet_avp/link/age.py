"""Age of information: how old the newest capture is that the receiver holds of one roadside unit.

Every unit has an age of its own: hand in the captures and arrivals of one sender at a time.
"""

from __future__ import annotations

import numpy as np

from pcdet_avp.errors import LinkError


def age_at(times_s: np.ndarray, captures_s: np.ndarray, arrivals_s: np.ndarray) -> np.ndarray:
    """(T,) s: age of the newest capture arrived by each time; infinite before the first arrival.

    ``captures_s`` (N,) and ``arrivals_s`` (N,): when each delivered map was captured and when it arrived.
    """
    arrivals, newest = _newest_after(captures_s, arrivals_s)
    index = np.searchsorted(arrivals, times_s, side="right")
    return np.asarray(times_s) - np.concatenate([[-np.inf], newest])[index]


def mean_age_s(captures_s: np.ndarray, arrivals_s: np.ndarray, start_s: float, stop_s: float) -> float:
    """Mean of the age over all times from start to stop (exact integral); the first arrival must not be later."""
    arrivals, newest = _newest_after(captures_s, arrivals_s)
    if not start_s < stop_s or not len(arrivals) or arrivals[0] > start_s:
        raise LinkError(f"mean age from {start_s} s to {stop_s} s: expected start before stop and a map held at start")
    edges = np.clip(np.append(arrivals, np.inf), start_s, stop_s)
    begin, end = edges[:-1], edges[1:]
    return float(((end - begin) * ((begin + end) / 2 - newest)).sum() / (stop_s - start_s))


def _newest_after(captures_s: np.ndarray, arrivals_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Arrivals in order, and the newest capture held after each."""
    order = np.argsort(arrivals_s, kind="stable")
    return np.asarray(arrivals_s)[order], np.maximum.accumulate(np.asarray(captures_s)[order])
