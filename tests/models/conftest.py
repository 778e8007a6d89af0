"""What tests of whole networks share."""

import pytest


@pytest.fixture
def select():
    """``select(batch, i)``: the batch of sample i alone."""

    def of_sample(batch, i):
        single = {"batch_size": 1}
        for key, value in batch.items():
            if key.startswith("points"):
                rows = value[value[:, 0] == i].clone()
                rows[:, 0] = 0
                single[key] = rows
            elif key != "batch_size":
                single[key] = value[i : i + 1]
        return single

    return of_sample
