"""AdaFusion's kernels against torch's operations: answers, and gradients."""

import copy
import itertools

import pytest
import torch

from pcdet_avp.models.cpu_kernels import fusion as kernels
from pcdet_avp.models.cpu_kernels.dispatch import plain_operations
from pcdet_avp.models.fusion.ada_fusion import AdaFusion
from pcdet_avp.structures.sensor_set import SOURCES

B, C, H, W = 2, 6, 5, 7


def fuser(seed=0, **cfg):
    torch.manual_seed(seed)
    return AdaFusion(cfg)


def batch(sources=SOURCES, seed=0, behind=0.0):
    """Maps whose absent cells hold ``behind``."""
    generator = torch.Generator().manual_seed(seed)
    maps, valid = {}, {}
    for source in sources:
        valid[source] = torch.rand(B, 1, H, W, generator=generator) < 0.6
        maps[source] = torch.where(valid[source], torch.randn(B, C, H, W, generator=generator), behind)
    return {"bev_maps": maps, "bev_valid": valid}


def both(module, data):
    with torch.no_grad():
        with plain_operations():
            expected = module(data)["spatial_features"]
        return module(data)["spatial_features"], expected


@pytest.mark.parametrize("original_form", [False, True])
@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_equals_torch_for_every_subset(count, original_form):
    for seed, sources in enumerate(itertools.combinations(SOURCES, count)):
        module = fuser(seed, ORIGINAL_FORM=original_form)
        torch.nn.init.normal_(module.spatial.conv.weight)  # all 54 of them
        torch.nn.init.constant_(module.spatial.conv.bias, 0.2)
        torch.testing.assert_close(*both(module, batch(sources, seed)), atol=2e-6, rtol=1e-5)


def test_equals_torch_where_all_weights_are_zero_and_where_no_map_is():
    module, data = fuser(), batch()
    torch.nn.init.constant_(module.channel.weights.weight, -1.0)
    torch.nn.init.constant_(module.combine.weights.weight, -1.0)
    torch.testing.assert_close(*both(module, data), atol=2e-6, rtol=1e-5)
    data["bev_valid"] = {source: torch.zeros_like(valid) for source, valid in data["bev_valid"].items()}
    found, expected = both(module, data)
    assert torch.equal(found, expected)
    assert not found.any()


@pytest.mark.parametrize("behind", [torch.nan, torch.inf, 1e30])
def test_absent_cells_are_not_read(behind):
    found, _ = both(fuser(), batch(behind=behind))
    assert torch.equal(found, both(fuser(), batch())[0])


def test_a_broken_number_in_a_present_cell_is_not_lost():
    data = batch()
    data["bev_valid"]["ego_lidar"][0, 0, 2, 3] = True
    data["bev_maps"]["ego_lidar"][0, 1, 2, 3] = torch.nan
    found, expected = both(fuser(), data)
    assert found[0].isnan().any()
    torch.testing.assert_close(found[1], expected[1], atol=2e-6, rtol=1e-5)


def gradients(module, data):
    """Of all maps and weights, for a random sum of the answer."""
    maps = {source: x.clone().requires_grad_() for source, x in data["bev_maps"].items()}
    out = module({**data, "bev_maps": maps})["spatial_features"]
    toward = torch.randn(out.shape, generator=torch.Generator().manual_seed(4)).to(out)
    return torch.autograd.grad(out, [*maps.values(), *module.parameters()], toward, allow_unused=True)


def compare_gradients(module, data):
    """Against torch's in float64: those of the perceptrons are differences of large sums."""
    exact = {**data, "bev_maps": {source: x.double() for source, x in data["bev_maps"].items()}}
    expected = gradients(copy.deepcopy(module).double(), exact)
    for i, (found, by_torch) in enumerate(zip(gradients(module, data), expected, strict=True)):
        valid = [*data["bev_valid"].values()][i] if i < len(data["bev_valid"]) else torch.tensor(True)
        by_torch = torch.where(valid, by_torch, 0)  # nobody reads those of absent cells
        atol = 1e-4 * max(1.0, float(by_torch.abs().max()))
        torch.testing.assert_close(found.double(), by_torch, atol=atol, rtol=1e-4)
    return expected


@pytest.mark.parametrize("original_form", [False, True])
@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_gradients_equal_torch_s_for_every_subset(count, original_form):
    for seed, sources in enumerate(itertools.combinations(SOURCES, count)):
        module = fuser(seed, ORIGINAL_FORM=original_form)
        torch.nn.init.normal_(module.spatial.conv.weight)
        torch.nn.init.constant_(module.spatial.conv.bias, 0.2)
        expected = compare_gradients(module, batch(sources, seed))
        assert all(grad.any() for grad in expected[: count + 2])  # the maps, and the convolution


def test_gradients_where_all_weights_are_zero_and_where_no_map_is():
    module, data = fuser(), batch()
    torch.nn.init.constant_(module.channel.weights.weight, -1.0)
    torch.nn.init.constant_(module.combine.weights.weight, -1.0)
    compare_gradients(module, data)
    data["bev_valid"] = {source: torch.zeros_like(valid) for source, valid in data["bev_valid"].items()}
    data["bev_maps"] = {source: torch.zeros_like(x) for source, x in data["bev_maps"].items()}
    assert not any(grad.any() for grad in gradients(fuser(), data)[: len(SOURCES)])


@pytest.mark.parametrize("behind", [torch.nan, 1e30])
def test_gradients_do_not_depend_on_absent_cells(behind):
    found, expected = gradients(fuser(), batch(behind=behind)), gradients(fuser(), batch())
    assert all(torch.equal(a, b) for a, b in zip(found, expected, strict=True))


def test_other_precisions_do_without(monkeypatch):
    monkeypatch.setattr(kernels, "fuse_sample", None)  # a call would raise
    data, module = batch(), fuser()
    with torch.autocast("cpu", torch.bfloat16):
        gradients(module, data)
    gradients(module.double(), {**data, "bev_maps": {s: x.double() for s, x in data["bev_maps"].items()}})
    with pytest.raises(TypeError):
        gradients(module.float(), data)
