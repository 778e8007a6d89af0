"""What is trained with is what is sent: exact zeros, exact rounding, a rate that can be steered."""

import pytest
import torch
from easydict import EasyDict
from hypothesis import given, settings
from hypothesis import strategies as st

from pcdet_avp.errors import ConfigError
from pcdet_avp.models.compression.bev_codec import BevCodec, Latent, NoCompression
from pcdet_avp.models.compression.map_codec import MapCodec
from pcdet_avp.models.compression.rounding import PRECISIONS, int8_exponents, round_to
from pcdet_avp.models.compression.sparsify import CellThreshold
from pcdet_avp.models.cpu_kernels.dispatch import plain_operations


def codec(channels=16, **keys):
    torch.manual_seed(0)
    return MapCodec(EasyDict(keys), channels)


def half_empty_map(batch=2, channels=16, height=12, width=8, seed=0):
    x = torch.randn(batch, channels, height, width, generator=torch.Generator().manual_seed(seed))
    x[:, :, 6:] = 0
    return x


def batch(sources=("infra_camera", "infra_lidar"), present=((1, 1, 1, 1), (1, 1, 0, 1))):
    maps = {s: half_empty_map(seed=i) for i, s in enumerate(("ego_lidar", *sources))}
    valid = {s: torch.ones(2, 1, 12, 8, dtype=torch.bool) for s in maps}
    return {"bev_maps": maps, "bev_valid": valid, "source_present": torch.tensor(present).float(), "batch_size": 2}


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("threshold", ["learned", "rate"])
def test_shapes_and_empty_cells(precision, threshold):
    module = codec(PRECISION=precision, THRESHOLD=threshold, TARGET_SHARE=0.9)
    latent, loss = module.compress(half_empty_map())
    assert latent.shape == (2, 2, 6, 4)
    assert loss.shape == (2,)
    assert latent[:, :, 3:].eq(0).all()
    assert latent[:, :, :3].ne(0).any()
    restored = module.decompress(latent)
    assert restored.shape == (2, 16, 12, 8)
    assert restored[:, :, 6:].eq(0).all()
    assert module.compress(torch.zeros(1, 16, 4, 4))[0].view(torch.int32).eq(0).all()  # not even a negative zero


def test_sparse_map_holds_the_occupied_cells_and_nothing_else():
    values = torch.zeros(2, 3, 2, 4)
    values[1, :, 0, 2] = torch.tensor([1.0, 0.0, -2.0])
    values[1, 1, 1, 3] = 5.0
    sparse = Latent(values, torch.ones(2, 1, 2, 4, dtype=torch.bool)).sparse(1)
    assert sparse.indices().tolist() == [[0, 1], [2, 3]]
    assert sparse.values().tolist() == [[1.0, 0.0, -2.0], [0.0, 5.0, 0.0]]
    assert torch.equal(sparse.to_dense(), values[1].permute(1, 2, 0))
    assert Latent(values, values[:, :1] == 0).sparse(0).values().shape == (0, 3)


def test_the_latent_is_its_own_float16():
    latent, _ = codec().compress(half_empty_map() * 1e5)
    assert torch.equal(latent, latent.half().float())
    assert latent.isfinite().all()


@given(st.integers(0, 2**32 - 1), st.integers(-30, 30))
@settings(max_examples=25, deadline=None)
def test_rounding_twice_is_rounding_once(seed, power):
    x = torch.randn(2, 3, 4, 5, generator=torch.Generator().manual_seed(seed)) * 2.0**power
    for precision in PRECISIONS:
        once = round_to(x, precision)
        assert torch.equal(round_to(once, precision), once)
    step = 2.0 ** int8_exponents(x)
    rounded = round_to(x, "int8")
    assert (rounded / step).abs().max() <= 127
    assert ((rounded - x).abs() <= step / 2).all()
    assert (step <= x.abs().amax((2, 3), keepdim=True) / 127 * 2).all()


def test_int8_exponent_at_its_edges():
    x = torch.tensor([127.0, 127.001, 128.0, 0.0]).view(4, 1, 1)
    assert int8_exponents(x).flatten().tolist() == [0, 1, 1, 0]


def test_rounding_lets_the_gradient_through():
    x = torch.randn(1, 2, 3, 3, requires_grad=True)
    round_to(x, "int8").sum().backward()
    assert x.grad.eq(1).all()


def test_max_pooling_keeps_a_single_hot_cell():
    module = codec(channels=8)
    module.reduce.weight.data.fill_(1 / 8)
    x = torch.zeros(1, 8, 4, 4)
    x[:, :, 2, 1] = 5.0
    latent, _ = module.compress(x)
    assert latent.nonzero().tolist() == [[0, 0, 1, 0]]
    assert latent[0, 0, 1, 0].item() == pytest.approx(4.9, abs=2e-3)  # shortened by the initial length 0.1
    module.restore.weight.data.fill_(2.0)
    assert module.decompress(latent)[0, 3].nonzero().tolist() == [[2, 0], [2, 1], [3, 0], [3, 1]]


def test_learned_threshold_drops_short_cells_whole_and_shortens_the_rest():
    threshold = CellThreshold(EasyDict(INITIAL_LENGTH=1.0))
    x = torch.tensor([[3.0, 0.5], [4.0, 0.5]]).view(1, 2, 1, 2)  # lengths 5 and 0.7
    kept, _ = threshold(x)
    torch.testing.assert_close(kept.view(2, 2), torch.tensor([[2.4, 0.0], [3.2, 0.0]]))


def test_threshold_gradients_by_finite_differences():
    threshold = CellThreshold(EasyDict(INITIAL_LENGTH=0.8)).double()
    x = torch.randn(1, 2, 3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1), requires_grad=True)
    assert torch.autograd.gradcheck(lambda t: threshold(t)[0], x)
    assert torch.autograd.gradcheck(
        lambda p: torch.func.functional_call(threshold, {"log_length": p}, (x,))[0],
        threshold.log_length.detach().requires_grad_(),
    )


def test_rate_loss_presses_only_above_the_target_and_reaches_it():
    x = torch.rand(1, 4, 10, 10, generator=torch.Generator().manual_seed(0)) + 0.5
    threshold = CellThreshold(EasyDict(INITIAL_LENGTH=0.01, TARGET_SHARE=0.2))
    optimiser = torch.optim.Adam(threshold.parameters(), lr=0.01)
    for _ in range(1000):
        optimiser.zero_grad()
        kept, loss = threshold(x)
        if loss == 0:
            break
        loss.sum().backward()
        optimiser.step()
    share = kept.ne(0).any(1).float().mean()
    assert loss == 0
    assert 0.1 < share <= 0.2


def test_rate_threshold_keeps_the_longest_cells_unchanged():
    x = torch.randn(2, 3, 10, 10, generator=torch.Generator().manual_seed(0))
    kept, loss = CellThreshold(EasyDict(THRESHOLD="rate", TARGET_SHARE=0.13))(x)
    occupied = kept.ne(0).any(1)
    assert occupied.sum((1, 2)).tolist() == [13, 13]
    assert loss.eq(0).all()
    lengths = x.norm(dim=1)
    assert all(lengths[i][occupied[i]].min() > lengths[i][~occupied[i]].max() for i in range(2))
    assert torch.equal(kept[0][:, occupied[0]], x[0][:, occupied[0]])
    assert torch.equal(CellThreshold(EasyDict(THRESHOLD="rate", TARGET_SHARE=1.0))(x)[0], x)


def test_max_share_caps_what_a_learned_threshold_lets_through():
    x = torch.randn(2, 4, 10, 10, generator=torch.Generator().manual_seed(3))
    uncapped, _ = CellThreshold(EasyDict(INITIAL_LENGTH=0.1))(x)
    capped, _ = CellThreshold(EasyDict(INITIAL_LENGTH=0.1, MAX_SHARE=0.13))(x)
    sent = (capped != 0).any(1)
    assert sent.flatten(1).sum(1).tolist() == [13, 13]
    assert torch.equal(capped, torch.where(sent[:, None], uncapped, 0))
    for length, kept in zip(uncapped.norm(dim=1), sent, strict=True):
        assert length[kept].min() >= length[~kept].max()


def test_codec_stage_replaces_the_roadside_maps():
    module, before = BevCodec(EasyDict(), 16), batch()
    after = module.decompress(module.compress(before))
    assert after["bev_maps"]["ego_lidar"] is before["bev_maps"]["ego_lidar"]
    assert after["bev_maps"]["infra_lidar"].shape == (2, 16, 12, 8)
    assert after["bev_maps"]["infra_camera"][1].eq(0).all()
    assert after["bev_valid"]["infra_camera"].flatten(1).all(1).tolist() == [True, False]
    assert after["bev_valid"]["infra_lidar"].all()  # empty cells of a map that arrived are present
    assert before["bev_maps"]["infra_lidar"] is not after["bev_maps"]["infra_lidar"]


def test_what_was_not_received_is_absent():
    module = BevCodec(EasyDict(), 16)
    sent = module.compress(batch())
    lidar = sent["latents"]["infra_lidar"]
    received = lidar.received.clone()
    received[:, :, 1] = False
    after = module.decompress({**sent, "latents": {"infra_lidar": Latent(lidar.values, received)}})
    assert set(after["bev_maps"]) == set(after["bev_valid"]) == {"ego_lidar", "infra_lidar"}
    assert not after["bev_valid"]["infra_lidar"][:, :, 2:4].any()
    assert after["bev_maps"]["infra_lidar"][:, :, 2:4].eq(0).all()


def test_absent_maps_do_not_count_in_the_loss_and_sparsity():
    module, one = BevCodec(EasyDict(TARGET_SHARE=0.1), 16), batch()
    loss, tb = module.get_loss(module.compress(one))
    one["bev_maps"]["infra_camera"][1] = 7.0
    again, tb_again = module.get_loss(module.compress(one))
    torch.testing.assert_close(again, loss, rtol=0, atol=0)
    torch.testing.assert_close(tb_again, tb, rtol=0, atol=0)
    assert tb["sparsity_infra_lidar"] == pytest.approx(0.5, abs=0.2)
    assert loss > 0


def test_samples_of_a_batch_do_not_mix():
    for keys in ({}, {"PRECISION": "int8"}, {"THRESHOLD": "rate"}):
        module, x = codec(**keys), half_empty_map(3)
        together, losses = module.compress(x)
        for i in range(3):
            alone, loss = module.compress(x[i : i + 1])
            torch.testing.assert_close(alone[0], together[i], atol=1e-6, rtol=1e-5)
            torch.testing.assert_close(loss[0], losses[i])


def test_everything_learns_and_sits_in_leaf_modules():
    module = BevCodec(EasyDict(TARGET_SHARE=0.05), 16)
    sent = module.compress(batch())
    maps = module.decompress(sent)["bev_maps"]
    (maps["infra_camera"].square().sum() + maps["infra_lidar"].square().sum() + module.get_loss(sent)[0]).backward()
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in module.parameters())
    leaves = {id(p) for m in module.modules() if not list(m.children()) for p in m.parameters()}
    assert leaves == {id(p) for p in module.parameters()}


def test_without_compression_maps_travel_as_they_are():
    module, before = NoCompression(EasyDict(), 16), batch()
    sent = module.compress(before)
    after = module.decompress(sent)
    assert torch.equal(after["bev_maps"]["infra_lidar"], before["bev_maps"]["infra_lidar"])
    assert after["bev_maps"]["infra_camera"][1].eq(0).all()
    assert module.get_loss(sent)[0] == 0


def test_full_size_costs_what_the_paper_says():
    latent, _ = codec(64).compress(torch.zeros(1, 64, 376, 280))
    assert latent.numel() * 2 == 421_120


def test_bad_configurations_are_refused():
    with pytest.raises(ConfigError, match="REDUCTION"):
        codec(12)
    with pytest.raises(ConfigError, match="PRECISION"):
        codec(PRECISION="int4")
    with pytest.raises(ConfigError, match="THRESHOLD"):
        codec(THRESHOLD="fixed")
    with pytest.raises(ConfigError, match="2 x 2"):
        codec().compress(torch.zeros(1, 16, 5, 4))


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_training_computes_the_same_latent_and_gradients_as_plain_operations(layout):
    module, x = codec(THRESHOLD="learned"), half_empty_map().contiguous(memory_format=layout)

    def train():
        leaf = x.clone().requires_grad_()
        latent, loss = module.compress(leaf)
        restored = module.decompress(latent)
        toward = torch.randn(restored.shape, generator=torch.Generator().manual_seed(1))
        total = (restored * toward).sum() + loss.sum()
        return latent, restored, torch.autograd.grad(total, [leaf, *module.parameters()])

    with plain_operations():
        latent, restored, gradients = train()
    found_latent, found_restored, found_gradients = train()
    assert torch.equal(found_latent, latent)
    torch.testing.assert_close(found_restored, restored, atol=1e-6, rtol=1e-6)
    for found, expected in zip(found_gradients, gradients, strict=True):
        assert expected.any()
        torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-5)
