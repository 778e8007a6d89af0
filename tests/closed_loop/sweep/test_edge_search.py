"""Bisection finds the edge that a monotonous truth has, with few trials away from it and all trials beside it."""

import pytest

from pcdet_avp.closed_loop.sweep.edge_search import next_cell

SPEEDS = [3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0]


def searched(crashes_at, few=10, trials=20):
    """The tally when the search has ended; ``crashes_at(speed, trials)`` is the truth."""
    tally = {}
    for _ in range(50):
        cell = next_cell(SPEEDS, tally, few, trials)
        if cell is None:
            return tally
        speed, n = cell
        tally[speed] = crashes_at(speed, n), n
    raise AssertionError("no end")


@pytest.mark.parametrize("edge", [2.0, *SPEEDS])
def test_finds_the_edge(edge):
    tally = searched(lambda v, n: 0 if v <= edge else n // 2)
    safe = [v for v, (k, _) in tally.items() if k == 0]
    assert max(safe, default=2.0) == edge
    for beside in (edge, edge + 1.0):
        assert tally.get(beside, (0, 20))[1] == 20
    assert len(tally) <= 5


def test_a_crash_that_shows_only_in_the_later_trials_moves_the_edge_down():
    tally = searched(lambda v, n: int(v >= 8) * n + int(v == 7 and n == 20))
    assert tally[7.0] == (1, 20)
    assert tally[6.0] == (0, 20)
