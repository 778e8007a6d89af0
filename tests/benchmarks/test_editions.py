"""Networks under the names that they have in another checkout."""

from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture
def named_in(load_benchmark):
    return load_benchmark("editions").named_in


@pytest.mark.parametrize(
    ("today", "before"),
    [
        ("cfgs/avp/cp_small.yaml", "cfgs/avp/cp_small_2.yaml"),
        ("weights/cp_small.pth", "weights/cp_small_2.pth"),
        ("cfgs/avp/cp_small_first.yaml", "cfgs/avp/cp_small.yaml"),
        ("weights/cp_small_first.pth", "weights/cp_small.pth"),
        ("cfgs/avp/cp_full.yaml", "cfgs/avp/cp_full.yaml"),
        ("/elsewhere/cp_small.pth", "/elsewhere/cp_small.pth"),
        ("none", "none"),
    ],
)
def test_an_older_checkout_has_the_names_of_then_and_this_one_those_of_today(named_in, tmp_path, today, before):
    assert named_in(tmp_path, today) == before
    assert named_in(REPOSITORY, today) == today
