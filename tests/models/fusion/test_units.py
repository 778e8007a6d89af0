"""Maps of several roadside units at one slot of the fuser: by hand, in any order, for samples with other numbers."""

import itertools

import pytest
import torch

from pcdet_avp.models.fusion.units import merge_units, strongest

C, H, W = 4, 5, 6


def units(count, seed=0, share=0.6):
    """Maps with many empty cells and negative values, and their masks."""
    generator = torch.Generator().manual_seed(seed)
    maps = torch.randn(count, C, H, W, generator=generator)
    maps = maps * (torch.rand(count, 1, H, W, generator=generator) < 0.5)
    masks = torch.rand(count, 1, H, W, generator=generator) < share
    return torch.where(masks, maps, 0), masks


def batch(maps, masks, samples, size):
    source = "infra_lidar"
    own = {"ego_camera": torch.ones(size, C, H, W)}
    return {
        "batch_size": size,
        "bev_maps": {source: maps, **own},
        "bev_valid": {source: masks, "ego_camera": torch.ones(size, 1, H, W, dtype=torch.bool)},
        "map_samples": {source: torch.tensor(samples)},
    }


def test_by_hand():
    """Three units, two elements a cell: the longest vector, not the largest elements; absent ones do not compete."""
    maps = torch.tensor([[[-3.0, 0, 9, 1]], [[1.0, 0, 0, 0]], [[2.0, 5, 0, 0]]]).view(3, 1, 1, 4).repeat(1, 2, 1, 1)
    maps[0, 1, 0, 0], maps[1, 1, 0, 0], maps[2, 1, 0, 0] = -4, 2, 1
    masks = torch.tensor([[1, 1, 0, 0], [1, 1, 1, 0], [1, 1, 0, 0]]).bool().view(3, 1, 1, 4)
    X, present = strongest(torch.where(masks, maps, 0), masks)
    assert present.tolist() == [[[True, True, True, False]]]
    assert X[0, 0].tolist() == [-3.0, 5.0, 0.0, 0.0]
    assert X[1, 0].tolist() == [-4.0, 5.0, 0.0, 0.0]


def test_a_unit_that_sees_nothing_there_changes_nothing():
    """Present and empty, as a hidden corner is: what another one found there stays bit for bit."""
    maps, masks = units(1)
    empty, everywhere = torch.zeros_like(maps), torch.ones_like(masks)
    X, present = strongest(torch.cat([empty, maps]), torch.cat([everywhere, masks]))
    assert torch.equal(X, maps[0])
    assert present.all()


@pytest.mark.parametrize("count", [2, 3, 4])
def test_the_order_of_the_units_changes_no_bit(count):
    maps, masks = units(count)
    maps[1] = maps[0].flip(0)  # vectors of equal length that are not the same
    maps = torch.where(masks, maps, 0)
    X, present = strongest(maps, masks)
    for order in itertools.permutations(range(count)):
        again = strongest(maps[list(order)], masks[list(order)])
        assert torch.equal(again[0], X)
        assert torch.equal(again[1], present)


def test_every_cell_is_one_unit_s_vector_and_absent_cells_are_zero():
    maps, masks = units(3, seed=4)
    X, present = strongest(maps, masks)
    assert torch.equal(present, masks.any(0))
    of_a_unit = ((maps == X) & masks).all(1, keepdim=True).any(0)
    assert torch.equal(of_a_unit, present)
    assert not X[:, ~present[0]].any()


def test_what_stands_under_a_false_mask_is_not_read():
    maps, masks = units(3)
    filled = torch.where(masks, maps, torch.nan)
    assert torch.equal(strongest(filled, masks)[0], strongest(maps, masks)[0])
    assert torch.equal(strongest(filled[:1], masks[:1])[0], strongest(maps[:1], masks[:1])[0])


def test_samples_with_no_one_two_and_three_units():
    maps, masks = units(6)
    samples = [3, 1, 2, 3, 2, 3]
    out = merge_units(batch(maps, masks, samples, 4))
    X, present = out["bev_maps"]["infra_lidar"], out["bev_valid"]["infra_lidar"]
    assert X.shape == (4, C, H, W)
    assert not X[0].any()
    assert not present[0].any()
    for sample in (1, 2, 3):
        rows = [k for k, s in enumerate(samples) if s == sample]
        alone = strongest(maps[rows], masks[rows])
        assert torch.equal(X[sample], alone[0])
        assert torch.equal(present[sample], alone[1])
    assert torch.equal(X[1], maps[1])
    assert torch.equal(out["bev_maps"]["ego_camera"], torch.ones(4, C, H, W))


def test_one_map_for_each_sample_passes_as_the_very_tensor():
    maps, masks = units(2)
    said, unsaid = batch(maps, masks, [0, 1], 2), batch(maps, masks, [0, 1], 2)
    del unsaid["map_samples"]
    for each in (said, unsaid):
        out = merge_units(each)
        assert out["bev_maps"]["infra_lidar"] is maps
        assert out["bev_valid"]["infra_lidar"] is masks


def test_one_map_for_each_sample_in_another_order_is_put_in_order():
    maps, masks = units(2)
    out = merge_units(batch(maps, masks, [1, 0], 2))
    assert torch.equal(out["bev_maps"]["infra_lidar"], maps.flip(0))


def test_gradients_reach_the_unit_whose_vector_counts():
    maps, masks = units(3)
    maps.requires_grad_()
    strongest(maps, masks)[0].sum().backward()
    assert torch.equal(maps.grad.abs().sum((0, 1)) > 0, masks.any(0)[0])
    assert not maps.grad[~masks.expand_as(maps)].any()


@pytest.mark.parametrize("samples", [[0, 0, 1], [1, 0, 0]])
def test_gradients_reach_the_only_unit_of_a_sample_beside_one_with_two(samples):
    """In a batch of sites with different numbers of units: the map is handed through, and so is its gradient."""
    maps, masks = units(3)
    maps.requires_grad_()
    merged = merge_units(batch(maps, masks, samples, 2))["bev_maps"]["infra_lidar"]
    merged.sum().backward()
    only = samples.index(1)
    assert torch.equal(maps.grad[only], masks[only].expand(C, H, W).float())
