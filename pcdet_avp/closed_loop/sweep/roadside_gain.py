"""What the roadside adds to the maximum safe speed, as far as what was run can tell."""

from __future__ import annotations

from math import inf

from pcdet_avp.closed_loop.sweep.crash_statistics import Tally, max_safe_speed


def roadside_gain(tally: Tally, alone: Tally) -> str:
    """Difference of the maximum safe speeds with (``tally``) and without the roadside; both have been run.

    ``+3 m/s``; ``at least +3 m/s`` where nothing faster was run that crashed with the roadside; ``more than +3 m/s``
    where the vehicle alone crashed even at the slowest speed; ``not known`` where no side is limited.
    """
    (low, high), (low_alone, high_alone) = _limits(tally), _limits(alone)
    least, most = low - high_alone, high - low_alone
    if least == most:
        return _mps(least)
    if least > -inf:
        return f"{'more than' if low_alone == -inf else 'at least'} {_mps(least)}"
    if most < inf:
        return f"{'less than' if low == -inf else 'at most'} {_mps(most)}"
    return "not known"


def _mps(difference: float) -> str:
    return f"{difference:+g} m/s" if difference else "0 m/s"


def _limits(tally: Tally) -> tuple[float, float]:
    """Between what the maximum safe speed lies: it is no more than a limit at the ends of what was run."""
    speed = max_safe_speed(tally)
    if speed is None:
        return -inf, min(tally)
    return (speed, inf) if speed == max(tally) else (speed, speed)
