"""Lost roadside maps and segments: how often, never the last source, the same on every rank."""

import numpy as np
import torch

from pcdet_avp.models.compression.bev_codec import Latent
from pcdet_avp.models.detectors.map_dropout import SEGMENTS, drop_roadside_maps, drop_segments


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


def latents(samples, cells=(4, 2 * SEGMENTS)):
    values = torch.ones(samples, 3, *cells)
    return {
        s: Latent(values, torch.ones(samples, 1, *cells, dtype=torch.bool)) for s in ("infra_camera", "infra_lidar")
    }


def test_segments_are_lost_whole_in_raster_order_with_their_values():
    out = drop_segments(latents(500), [f"s/{i}" for i in range(500)], 1.0, step=2)["infra_lidar"]
    runs = out.received.flatten(1).view(500, SEGMENTS, -1)
    assert (runs.all(2) | ~runs.any(2)).all()
    assert torch.equal(out.values != 0, out.received.expand_as(out.values))
    lost = 1 - runs[..., 0].float().mean()
    assert abs(lost - 0.25) < 0.03  # rates are drawn between none and half of the segments


def test_most_maps_lose_nothing_and_the_two_maps_lose_independently():
    out = drop_segments(latents(3000), [f"s/{i}" for i in range(3000)], 0.2, step=2)
    hurt = torch.stack([(~latent.received).flatten(1).any(1) for latent in out.values()])
    share = hurt.float().mean()
    assert 0.1 < share < 0.2  # a drawn rate near zero may lose nothing
    assert abs(hurt.all(0).float().mean() - share**2) < 0.015


def test_lost_segments_depend_on_step_and_frame_only_and_absent_stays_absent():
    ids = [f"s/{i}" for i in range(8)]
    whole = latents(8)
    whole["infra_lidar"].received[3] = False
    out = drop_segments(whole, ids, 0.7, step=5)["infra_lidar"]
    half = {s: Latent(m.values[4:], m.received[4:]) for s, m in whole.items()}
    assert torch.equal(out.received[4:], drop_segments(half, ids[4:], 0.7, step=5)["infra_lidar"].received)
    assert not out.received[3].any()
    assert (out.values[3] == 0).all()
    assert not torch.equal(out.received, drop_segments(whole, ids, 0.7, step=6)["infra_lidar"].received)
