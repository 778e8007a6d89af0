"""The frustum's kernel against torch's operations: answers, and gradients."""

import math

import pytest
import torch
from easydict import EasyDict

from pcdet_avp.models.backbones_2d.map_to_bev import frustum_kernel as kernels
from pcdet_avp.models.backbones_2d.map_to_bev.frustum_to_bev import FrustumToBev
from pcdet_avp.models.backbones_image.depth_bins import DepthBins
from pcdet_avp.models.cpu_kernels.dispatch import plain_operations
from pcdet_avp.models.precision import computing_in
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.camera import PinholeCamera

GRID, BINS = BevGrid(0.0, -6.0, -0.5, 10.0, 6.0, 3.5, 0.5), DepthBins("LID", 7, 1.0, 9.0)
SIZE, STRIDE = (22, 40), 4  # the last row of feature pixels covers only half of its image rows
CAMERA = PinholeCamera.looking_ahead(SIZE[1], SIZE[0], math.pi / 2, 0.0, 1.8, math.radians(10))


def head(sampling="trilinear", channels=16):
    torch.manual_seed(0)
    return FrustumToBev(EasyDict(HEIGHTS=4, SAMPLING=sampling, NUM_BEV_FEATURES=8), GRID, channels).eval()


def images(batch=2, channels=16):
    """Features, depth logits, calibration."""
    generator = torch.Generator().manual_seed(1)
    features = torch.randn(batch, channels, 6, 10, generator=generator)
    logits = torch.randn(batch, BINS.count + 1, 6, 10, generator=generator) * 2
    matrix = torch.tensor(CAMERA.intrinsics @ CAMERA.agent_from_camera.inverse().matrix[:3])
    return features, logits, matrix.expand(batch, 3, 4).clone()


def both(to_bev, features, logits, matrix):
    """Maps by torch's operations and by the kernel."""
    with torch.no_grad():
        with plain_operations():
            expected, seen = to_bev(features, logits, matrix, BINS, SIZE, STRIDE)
        found, found_seen = to_bev(features, logits, matrix, BINS, SIZE, STRIDE)
    assert torch.equal(found_seen, seen)
    return expected, found


@pytest.mark.parametrize("batch", [0, 1, 2])
@pytest.mark.parametrize("chunk", [7, kernels.CHUNK_COLUMNS])
def test_equals_torch(monkeypatch, batch, chunk):
    monkeypatch.setattr(kernels, "CHUNK_COLUMNS", chunk)
    expected, found = both(head(), *images(batch))
    torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-5)
    assert torch.equal(found == 0, expected == 0)
    assert expected.flatten(1).any(1).all()  # every sample has something to compare


@pytest.mark.parametrize("layout", ["channels_last", "every second channel", "a part of a larger image"])
def test_memory_layouts(layout):
    features, logits, matrix = images()
    if layout == "channels_last":
        features, logits = (t.contiguous(memory_format=torch.channels_last) for t in (features, logits))
    elif layout == "every second channel":
        features = torch.stack([features, features + 1], 2).flatten(1, 2)[:, ::2]
    else:
        features = torch.nn.functional.pad(features, (1, 2, 2, 0), value=9.0)[:, :, 2:, 1:-2]
    torch.testing.assert_close(*both(head(), features, logits, matrix), atol=1e-5, rtol=1e-5)


def test_a_camera_that_sees_no_cell():
    features, logits, matrix = images()
    matrix[:, 2, 3] -= 100.0  # everything lies behind it
    expected, found = both(head(), features, logits, matrix)
    assert not expected.any()
    assert not found.any()


def test_a_broken_number_is_not_lost():
    features, logits, matrix = images(1)
    features[0, 2, 3, 5] = torch.nan
    _, found = both(head(), features, logits, matrix)
    assert found.isnan().any()


def test_what_next_to_nothing_is_seen_of_stays_zero():
    """A pixel is sure of its depth: only the columns at that depth hold anything, and the map hardly changes."""
    features, logits, matrix = images(1)
    logits[:, 3] += 14.0  # e^-14 is a tenth of what counts as nothing
    expected, found = both(head(), features, logits, matrix)
    empty = (expected != 0).any(1) & (found == 0).all(1)
    assert 0.2 < float(empty.float().mean() / (expected != 0).any(1).float().mean()) < 0.9
    torch.testing.assert_close(found, expected, atol=1e-3 * float(expected.abs().max()), rtol=0)


@pytest.mark.parametrize("chunk", [1, 2, 3, 5, kernels.CHUNK_COLUMNS])
@pytest.mark.parametrize("precision", ["float32", "bf16"])
def test_any_number_of_columns_may_be_left_when_a_chunk_is_full(monkeypatch, chunk, precision):
    """All pixels are sure that the depth lies beyond the bins, but one: few columns hold anything, or none."""
    monkeypatch.setattr(kernels, "CHUNK_COLUMNS", chunk)
    features, logits, matrix = images(2)
    logits[:, -1] += 40.0
    logits[1, 3, 3, 5] += 60.0
    with computing_in(precision):
        expected, found = both(head(), features, logits, matrix)
    torch.testing.assert_close(found, expected, atol=0.02 * float(expected.abs().max()), rtol=0)
    assert not found[0].any()
    assert 0 < int((found[1] != 0).any(0).sum()) < 30


def test_in_bf16_the_map_is_the_same_but_for_rounding():
    inputs, to_bev = images(), head()
    with torch.no_grad():
        exact, _ = to_bev(*inputs, BINS, SIZE, STRIDE)
        with computing_in("bf16"):
            rough, _ = to_bev(*inputs, BINS, SIZE, STRIDE)
    assert rough.dtype == torch.float32
    assert not torch.equal(rough, exact)
    torch.testing.assert_close(rough, exact, atol=0.01 * float(exact.abs().max()), rtol=0)


def test_in_bf16_products_come_in_few_sizes_with_the_same_bits(monkeypatch):
    """However many columns hold anything: for every new size code would be generated, and kept."""
    to_bev, (features, logits, matrix), multiply = head(), images(1), torch.mm
    sizes, maps = {1: set(), 64: set()}, {1: [], 64: []}
    for step in sizes:
        monkeypatch.setattr(kernels, "PRODUCT_ROWS", step)
        monkeypatch.setattr(torch, "mm", lambda a, *b, of=sizes[step], **out: of.add(len(a)) or multiply(a, *b, **out))
        for sure in range(6):  # of its depth a pixel is more and more
            logits[:, 3] = 3.0 * sure
            with torch.no_grad(), computing_in("bf16"):
                maps[step].append(to_bev(features, logits, matrix, BINS, SIZE, STRIDE)[0])
    assert len(sizes[1]) > 2
    assert sizes[64] <= set(range(0, 24 * 20 + 64, 64))
    assert torch.equal(torch.cat(maps[1]), torch.cat(maps[64]))


def gradients(to_bev, features, logits, matrix):
    """Of random sums of the maps: for features, logits and all weights."""
    inputs = [features.clone().requires_grad_(), logits.clone().requires_grad_()]
    maps, _ = to_bev(*inputs, matrix, BINS, SIZE, STRIDE)
    toward = torch.randn(maps.shape, generator=torch.Generator().manual_seed(4))
    return torch.autograd.grad(maps, [*inputs, *to_bev.parameters()], toward)


@pytest.mark.parametrize("chunk", [7, kernels.CHUNK_COLUMNS])
def test_gradients_equal_torch_s(monkeypatch, chunk):
    monkeypatch.setattr(kernels, "CHUNK_COLUMNS", chunk)
    to_bev, inputs = head(), images()
    with plain_operations():
        expected = gradients(to_bev, *inputs)
    for found, by_torch in zip(gradients(to_bev, *inputs), expected, strict=True):
        assert by_torch.any()
        torch.testing.assert_close(found, by_torch, atol=1e-5 * float(by_torch.abs().max()), rtol=1e-4)


def test_gradients_are_the_same_bits_every_time():
    first, second = (gradients(head(), *images()) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


def test_other_samplings_do_without(monkeypatch):
    for name in ("collapse", "normalised_map"):
        monkeypatch.setattr(kernels, name, None)  # a call would raise
    to_bev, (features, logits, matrix) = head(), images()
    gradients(head("nearest"), features, logits, matrix)
    with torch.no_grad():
        head("nearest")(features, logits, matrix, BINS, SIZE, STRIDE)
        head("factorised")(features, logits, matrix, BINS, SIZE, STRIDE)
        with pytest.raises(TypeError):
            to_bev(features, logits, matrix, BINS, SIZE, STRIDE)
