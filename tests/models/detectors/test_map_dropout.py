"""Lost roadside maps: how often, never the last source, the same on every rank."""

import numpy as np
import torch

from pcdet_avp.models.detectors.map_dropout import drop_roadside_maps


def batch(rows, ids=None):
    present = torch.tensor(rows, dtype=torch.float32)
    return {"source_present": present, "frame_id": np.array(ids or [f"s/{i}" for i in range(len(rows))])}


def test_the_share_lost_is_the_probability_and_the_ego_loses_nothing():
    data = batch([[1, 1, 1, 1]] * 4000)
    kept = drop_roadside_maps(data, 0.25, step=3)["source_present"]
    assert (kept[:, :2] == 1).all()
    assert abs(kept[:, 2:].mean() - 0.75) < 4 * np.sqrt(0.25 * 0.75 / 8000)
    both = (kept[:, 2] + kept[:, 3] == 0).float().mean()
    assert abs(both - 0.0625) < 0.02  # the two maps are lost independently
    assert (data["source_present"] == 1).all()


def test_absent_stays_absent_and_the_last_source_stays():
    kept = drop_roadside_maps(batch([[1, 0, 0, 1], [0, 0, 1, 1]]), 1.0, step=0)["source_present"]
    assert kept.tolist() == [[1, 0, 0, 0], [0, 0, 1, 1]]


def test_what_is_lost_depends_on_step_and_frame_only():
    data = batch([[1, 1, 1, 1]] * 64)
    whole = drop_roadside_maps(data, 0.5, step=7)["source_present"]
    halves = [batch([[1, 1, 1, 1]] * 32, list(ids)) for ids in np.split(data["frame_id"], 2)]
    assert torch.equal(whole, torch.cat([drop_roadside_maps(h, 0.5, step=7)["source_present"] for h in halves]))
    assert not torch.equal(whole, drop_roadside_maps(data, 0.5, step=8)["source_present"])
