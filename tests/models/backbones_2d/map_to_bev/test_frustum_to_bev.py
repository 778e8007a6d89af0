"""Frustum to BEV against CaDDN's own way (frustum volume, 3-D grid_sample, 1 x 1 convolution) and trigonometry."""

import gc
import math
import weakref

import numpy as np
import pytest
import torch
from easydict import EasyDict
from torch.nn import functional as F

from pcdet_avp.errors import ConfigError
from pcdet_avp.models.backbones_2d.map_to_bev import frustum_collapse as module
from pcdet_avp.models.backbones_2d.map_to_bev import frustum_to_bev
from pcdet_avp.models.backbones_2d.map_to_bev.frustum_collapse import frustum_collapse
from pcdet_avp.models.backbones_2d.map_to_bev.frustum_to_bev import FrustumToBev
from pcdet_avp.models.backbones_2d.map_to_bev.voxel_projection import VoxelProjection, project_voxels
from pcdet_avp.models.backbones_image.depth_bins import DepthBins
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.pose import Pose

GRID = BevGrid(0.0, -6.0, -0.5, 10.0, 6.0, 3.5, 1.0)
BINS = DepthBins("LID", 7, 1.0, 9.0)
SIZE, STRIDE, HEIGHTS = (22, 40), 4, 4  # the last row of feature pixels covers only half of its image rows
CAMERA = PinholeCamera.looking_ahead(SIZE[1], SIZE[0], math.pi / 2, 0.0, 1.8, math.radians(10))


def image_from_agent(camera=CAMERA, yaw=0.0):
    turned = Pose.from_xyz_yaw(0, 0, 0, yaw) @ camera.agent_from_camera
    return torch.tensor(camera.intrinsics @ turned.inverse().matrix[:3])


def head(sampling="trilinear", channels=3, outputs=5, grid=GRID, num_heights=HEIGHTS):
    torch.manual_seed(0)
    return FrustumToBev(EasyDict(HEIGHTS=num_heights, SAMPLING=sampling, NUM_BEV_FEATURES=outputs), grid, channels)


def random_images(batch=1, channels=3, seed=0):
    generator = torch.Generator().manual_seed(seed)
    features = torch.randn(batch, channels, 6, 10, generator=generator)
    return features, torch.randn(batch, BINS.count + 1, 6, 10, generator=generator) * 2


def caddn(to_bev, features, logits, matrix, sampling="trilinear"):
    """The map before the norm, by way of the frustum volume and the voxel volume."""
    x, y = GRID.cell_centres()
    z = -0.5 + (np.arange(HEIGHTS) + 0.5) * 4.0 / HEIGHTS
    points = np.stack([*np.meshgrid(x, y, indexing="xy"), np.zeros((len(y), len(x)))], -1)[None].repeat(HEIGHTS, 0)
    points[..., 2] = z[:, None, None]
    u, v, depth = np.moveaxis(points @ matrix.numpy()[:, :3].T + matrix.numpy()[:, 3], -1, 0)
    u, v = u / depth, v / depth
    seen = (depth >= 1.0) & (depth < 9.0) & (u >= 0) & (u < SIZE[1]) & (v >= 0) & (v < SIZE[0])
    k = BINS.position(torch.tensor(depth)).numpy()
    # align_corners=False: -1 and 1 are the outer borders; a feature pixel is 4 image pixels wide.
    grid = np.stack([u / STRIDE / 10 * 2 - 1, v / STRIDE / 6 * 2 - 1, k / BINS.count * 2 - 1], -1)
    grid = torch.tensor(grid, dtype=torch.float32)[None]
    probabilities = logits.softmax(1)[:, : BINS.count]
    if sampling == "nearest":
        at = [np.clip(np.floor(w / STRIDE), 0, n - 1).astype(int) for w, n in ((v, 6), (u, 10))]
        near = np.stack([(at[1] + 0.5) / 10 * 2 - 1, (at[0] + 0.5) / 6 * 2 - 1, grid[0, ..., 2]], -1)
        voxels = F.grid_sample(
            features[:, :, None] * probabilities[:, None], torch.tensor(near).float()[None], align_corners=False
        )
    elif sampling == "factorised":
        flat = F.grid_sample(features, grid[..., :2].view(1, -1, 1, 2), align_corners=False)
        chance = F.grid_sample(probabilities[:, None], grid, align_corners=False)
        voxels = flat.view(1, features.shape[1], *grid.shape[1:4]) * chance
    else:
        frustum = features[:, :, None] * probabilities[:, None]
        voxels = F.grid_sample(frustum, grid, align_corners=False)
    voxels = voxels * torch.tensor(seen)[None, None]
    return to_bev.collapse(voxels.flatten(1, 2)), torch.tensor(seen).any(0)[None, None]


@pytest.mark.parametrize("yaw", [0.0, 0.3])
@pytest.mark.parametrize("sampling", ["trilinear", "factorised", "nearest"])
def test_equals_the_explicit_frustum_and_its_gradients(yaw, sampling):
    to_bev = head(sampling)
    features, logits = (t.requires_grad_() for t in random_images())
    matrix = image_from_agent(yaw=yaw)
    collapsed, seen = caddn(to_bev, features, logits, matrix, sampling)
    expected = F.relu(to_bev.norm(collapsed * seen, seen))
    found, valid = to_bev(features, logits, matrix[None], BINS, SIZE, STRIDE)
    assert torch.equal(valid, seen)
    assert 20 < int(valid.sum()) < valid.numel()
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)
    factor = torch.randn(found.shape, generator=torch.Generator().manual_seed(5))
    inputs = (features, logits, to_bev.collapse.weight)
    wanted = torch.autograd.grad((expected * factor).sum(), inputs)
    for f, w in zip(torch.autograd.grad((found * factor).sum(), inputs), wanted, strict=True):
        torch.testing.assert_close(f, w, atol=2e-4, rtol=1e-3)


@pytest.mark.parametrize("sampling", ["trilinear", "factorised"])
def test_gradients_by_finite_differences(sampling, monkeypatch):
    monkeypatch.setattr(module, "CHUNK_VOXELS", 4)  # three columns of two heights: two chunks
    generator = torch.Generator().manual_seed(0)
    projection = VoxelProjection(
        columns=torch.arange(3),
        pixels=torch.tensor([[0, 1], [4, 5], [5, 0]], dtype=torch.int32),
        weights=torch.rand(3, 2, 4, generator=generator, dtype=torch.float64),
        bins=torch.tensor([[0, 1], [2, 1], [0, 2]], dtype=torch.int32),
        bin_shift=torch.rand(3, 2, generator=generator, dtype=torch.float64),
        image_size=(3, 4),
    )
    shapes = ((12, 2), (12, 4), (3, 2, 2))
    inputs = [torch.randn(s, generator=generator, dtype=torch.float64, requires_grad=True) for s in shapes]
    assert torch.autograd.gradcheck(lambda *t: frustum_collapse(*t, projection, sampling), inputs)


def test_a_pixel_of_known_depth_lands_in_the_cell_that_trigonometry_says():
    """Level camera 1.8 m up, focal length 20 px: 5 m ahead and 2 m to the left is u = 20 - 20 * 2 / 5 = 12."""
    camera = PinholeCamera.looking_ahead(40, 22, math.pi / 2, 0.0, 1.8)
    grid = BevGrid(0.0, -6.0, 1.3, 10.0, 6.0, 2.3, 0.5)  # one layer, at the camera's own height
    bins = DepthBins("UD", 16, 1.0, 9.0)  # 0.5 m each
    to_bev = head(channels=1, outputs=1, grid=grid, num_heights=1)
    to_bev.collapse.weight.data.fill_(1.0)
    features = torch.zeros(1, 1, 6, 10)
    features[0, 0, 2, 3] = 1.0  # columns 12-15, rows 8-11 of the image
    logits = torch.full((1, 17, 6, 10), -50.0)
    logits[:, 8] = 50.0  # bin 8 is 5.0-5.5 m
    found, _ = to_bev(features, logits, image_from_agent(camera)[None], bins, (22, 40), 4)
    row, col = divmod(int(found[0, 0].argmax()), grid.width)
    x, y = grid.cell_centres()
    expected_y = (20 - 14) / 20 * 5.25  # pixel centre u = 14
    assert x[col] == 5.25
    assert abs(y[row] - expected_y) <= 0.25
    elsewhere = found[0, 0].clone()
    elsewhere[:, col] = 0
    assert elsewhere.max() < 1e-4 * found.max()


def test_a_cell_is_seen_exactly_if_the_camera_sees_a_voxel_centre_of_it():
    projection = project_voxels(image_from_agent(), GRID, HEIGHTS, BINS, SIZE, STRIDE)
    x, y = GRID.cell_centres()
    z = -0.5 + (np.arange(HEIGHTS) + 0.5) * 4.0 / HEIGHTS
    centres = np.stack(np.meshgrid(y, x, z, indexing="ij"), -1)[..., [1, 0, 2]]
    depth = CAMERA.project(centres)[1]
    seen = CAMERA.sees(centres) & (depth >= 1.0) & (depth < 9.0)
    assert projection.columns.tolist() == np.flatnonzero(seen.any(-1)).tolist()
    assert ((projection.weights.sum(-1) > 0).numpy() == seen.reshape(-1, HEIGHTS)[projection.columns]).all()


def test_a_uniform_image_gives_every_seen_voxel_the_probability_of_its_depth():
    to_bev = head(channels=1, outputs=1)
    features, logits = torch.ones(1, 1, 6, 10), torch.randn(BINS.count + 1).view(1, -1, 1, 1).expand(1, -1, 6, 10)
    projection = project_voxels(image_from_agent(), GRID, HEIGHTS, BINS, SIZE, STRIDE)
    probabilities = F.pad(logits.softmax(1)[0, : BINS.count, 0, 0], (1, 1))
    lower, upper = probabilities[projection.bins], probabilities[projection.bins + 1]
    at_depth = (lower + (upper - lower) * projection.bin_shift) * projection.weights.sum(-1)
    weight = to_bev.collapse.weight.view(1, 1, HEIGHTS)
    padded = F.pad(features[0, 0], (1, 1, 1, 1)).view(-1, 1)
    inside = F.pad(logits.softmax(1)[0, : BINS.count], (1, 1, 1, 1, 1, 1)).flatten(1).T.contiguous()
    found = frustum_collapse(padded, inside, weight, projection)
    interior = (projection.weights.sum(-1) > 0) & ((projection.pixels % 12) > 0) & ((projection.pixels % 12) < 10)
    interior &= (projection.pixels // 12 > 0) & (projection.pixels // 12 < 6)
    keep = interior.all(1)
    assert keep.any()
    torch.testing.assert_close(found[keep], (at_depth @ weight[0, 0])[keep][:, None], atol=1e-6, rtol=1e-4)


def test_outside_the_field_of_view_and_for_empty_features_the_map_is_zero():
    to_bev = head()
    features, logits = random_images(2)
    found, seen = to_bev(features, logits, image_from_agent().expand(2, 3, 4), BINS, SIZE, STRIDE)
    assert (found * ~seen).eq(0).all()
    empty, seen = to_bev(torch.zeros_like(features), logits, image_from_agent().expand(2, 3, 4), BINS, SIZE, STRIDE)
    assert empty.eq(0).all()
    assert seen.any()


def test_samples_of_a_batch_do_not_mix_and_no_sample_is_no_error():
    to_bev = head()
    features, logits = random_images(3)
    matrices = torch.stack([image_from_agent(yaw=yaw) for yaw in (0.0, 0.2, -0.4)])
    together, seen = to_bev(features, logits, matrices, BINS, SIZE, STRIDE)
    for i in range(3):
        alone, seen_alone = to_bev(features[i : i + 1], logits[i : i + 1], matrices[i : i + 1], BINS, SIZE, STRIDE)
        torch.testing.assert_close(alone[0], together[i], atol=1e-5, rtol=1e-5)
        assert torch.equal(seen_alone[0], seen[i])
    none, _ = to_bev(features[:0], logits[:0], matrices[:0], BINS, SIZE, STRIDE)
    assert none.shape == (0, 5, GRID.height, GRID.width)


def test_a_camera_that_sees_nothing_of_the_grid():
    to_bev = head()
    features, logits = (t.requires_grad_() for t in random_images())
    backwards = Pose.from_xyz_yaw(0, 0, 0, math.pi) @ CAMERA.agent_from_camera
    matrix = torch.tensor(CAMERA.intrinsics @ backwards.inverse().matrix[:3])
    found, seen = to_bev(features, logits, matrix[None], BINS, SIZE, STRIDE)
    found.sum().backward()
    assert not seen.any()
    assert not found.any()
    assert features.grad.eq(0).all()


def test_chunks_do_not_change_the_result(monkeypatch):
    to_bev = head()
    features, logits = random_images()
    whole, _ = to_bev(features, logits, image_from_agent()[None], BINS, SIZE, STRIDE)
    monkeypatch.setattr(module, "CHUNK_VOXELS", 12)
    torch.testing.assert_close(to_bev(features, logits, image_from_agent()[None], BINS, SIZE, STRIDE)[0], whole)


def test_cameras_that_come_again_in_any_order_give_the_maps_of_a_fresh_layer():
    """More cameras than are remembered, twice: a projection that is kept or thrown away changes nothing."""
    to_bev, (features, logits) = head(), random_images()
    yaws = [*np.linspace(0, 0.5, 7), 0.5, 0.0, 0.25]
    for yaw in yaws:
        fresh = head()
        fresh.load_state_dict(to_bev.state_dict())
        camera = image_from_agent(yaw=yaw)[None]
        kept, seen = to_bev(features, logits, camera, BINS, SIZE, STRIDE)
        expected, expected_seen = fresh(features, logits, camera, BINS, SIZE, STRIDE)
        assert torch.equal(kept, expected)
        assert torch.equal(seen, expected_seen)


def test_a_camera_is_projected_once_while_it_is_in_use(monkeypatch):
    """A mast's camera stands still for hours; many cameras in turn (training) must not fill the memory either."""
    projected, alive = [], weakref.WeakSet()

    def project(*words):
        projection = project_voxels(*words)
        alive.add(projection)
        projected.append(1)
        return projection

    monkeypatch.setattr(frustum_to_bev, "project_voxels", project)
    to_bev, (features, logits) = head(), random_images()
    for _ in range(3):
        to_bev(features, logits, image_from_agent(yaw=0.5)[None], BINS, SIZE, STRIDE)
    assert len(projected) == 1
    for yaw in np.linspace(0, 0.5, 20):
        to_bev(features, logits, image_from_agent(yaw=yaw)[None], BINS, SIZE, STRIDE)
    gc.collect()
    assert len(alive) < 8


def test_an_unknown_sampling_is_refused():
    with pytest.raises(ConfigError, match="trilinear, factorised, nearest"):
        head("bicubic")
