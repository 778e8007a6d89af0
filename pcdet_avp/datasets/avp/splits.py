"""Which scenes are trained on, validated on and tested on. Always whole scenes: neighbours in time look alike."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pcdet_avp.errors import RecordError

SPLITS = ("train", "val", "test")
TEST_SHARE = 0.2  # paper: 80:20
VAL_SHARE = 0.1  # of the scenes that are not tested on


def assign_splits(
    scenes: Iterable[str], seed: int, test_share: float = TEST_SHARE, val_share: float = VAL_SHARE
) -> dict[str, str]:
    """scene -> split. Depends on the names and the seed, not on their order.

    Shares are rounded to whole scenes; with three scenes or more, each split whose share is not 0 gets at least one.
    """
    names = sorted(scenes)
    if len(set(names)) != len(names):
        raise RecordError(f"a scene is listed twice: {sorted({n for n in names if names.count(n) > 1})}")
    least = 1 if len(names) >= len(SPLITS) else 0
    test = max(round(test_share * len(names)), least if test_share else 0)
    val = max(round(val_share * (len(names) - test)), least if val_share else 0)
    shuffled = np.random.default_rng(seed).permutation(names).tolist()
    split = ["test"] * test + ["val"] * val + ["train"] * (len(names) - test - val)
    assigned = dict(zip(shuffled, split, strict=True))
    return {name: assigned[name] for name in names}
