"""Where safe speeds end, without running every cell: bisection with a few trials, all trials at the edge.

The search takes for granted that what is slower than a safe speed is safe. It is a pure function of what has been
run, so that it goes on where it stopped.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence


def next_cell(
    speeds: Sequence[float], tally: Mapping[float, tuple[int, int]], few: int, trials: int
) -> tuple[float, int] | None:
    """The speed to try next and with how many trials; None once the edge is known with ``trials`` on both sides.

    ``tally`` holds crashes and trials of the speeds (ascending) that have been run.
    """
    unsafe = [i for i, speed in enumerate(speeds) if tally.get(speed, (0, 0))[0] > 0]
    above = min(unsafe, default=len(speeds))
    below = max((i for i in range(above) if tally.get(speeds[i], (0, 0))[1] >= few), default=-1)
    if above - below > 1:
        return speeds[(above + below) // 2], few
    for edge in (below, above):
        if 0 <= edge < len(speeds) and tally[speeds[edge]][1] < trials:
            return speeds[edge], trials
    return None
