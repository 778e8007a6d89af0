"""Our stages before PointPillars' backbone."""

import pytest
import torch
from easydict import EasyDict

from pcdet_avp.models.backbones_2d.base_bev_backbone import BaseBEVBackbone
from pcdet_avp.models.backbones_2d.wrapped_backbones import CompressedBackbone, DeformableAttentionBackbone

STAGES = {
    "LAYER_NUMS": [1, 1],
    "LAYER_STRIDES": [1, 2],
    "NUM_FILTERS": [8, 16],
    "UPSAMPLE_STRIDES": [1, 2],
    "NUM_UPSAMPLE_FILTERS": [8, 8],
}


@pytest.fixture
def x():
    return torch.randn(2, 8, 12, 8, generator=torch.Generator().manual_seed(1))


def build(cls, **changes):
    torch.manual_seed(0)
    return cls(EasyDict(STAGES | changes), 8).eval()


def test_with_a_trained_backbones_weights_attention_starts_as_that_backbone(x):
    plain, wrapped = build(BaseBEVBackbone, NORM="batch"), build(DeformableAttentionBackbone)
    missing = wrapped.load_state_dict(plain.state_dict(), strict=False)
    assert missing.unexpected_keys == []
    assert all(key.startswith("attention.") for key in missing.missing_keys)
    torch.testing.assert_close(wrapped.encode(x), plain.encode(x))


def test_a_cell_sees_another_through_attention_only(x):
    """A map that is empty but for one cell: without the backbone's 3 x 3 reach, only attention can carry it along."""
    wrapped = build(DeformableAttentionBackbone, ATTENTION={"HEADS": 4, "POINTS": 4})
    far, empty = torch.zeros(1, 8, 48, 8), torch.zeros(1, 8, 48, 8)
    far[0, :, 30, 4] = 1.0
    with torch.no_grad():
        wrapped.attention.output.weight.copy_(torch.eye(8))
        wrapped.attention.value.weight.copy_(torch.eye(8))
        moved = wrapped.attention(far, torch.ones(1, 1, 48, 8).bool())
    assert torch.equal(wrapped.attention(empty, torch.ones(1, 1, 48, 8).bool()), empty)
    rows = (moved.abs().sum((0, 1, 3)) > 1e-4).nonzero().flatten().tolist()
    assert rows == list(range(26, 35))  # four points a head, up to four cells away


def test_the_compressed_backbone_sees_what_was_sent_and_nothing_else(x):
    """At a share of a tenth, 2 of the 24 pooled cells arrive: the map is zero in all others."""
    wrapped = build(CompressedBackbone, COMPRESSION={"REDUCTION": 4, "TARGET_SHARE": 0.1})
    seen = []
    hook = wrapped.blocks[0].register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    out = wrapped.encode(x)
    hook.remove()
    assert out.shape == (2, 16, 12, 8)
    assert [int((of_sample != 0).any(0).sum()) for of_sample in seen[0]] == [2 * 4, 2 * 4]


def test_openpcdets_norm_is_the_default_and_ours_can_be_chosen():
    assert any(key.endswith("running_mean") for key in build(DeformableAttentionBackbone).state_dict())
    grouped = build(DeformableAttentionBackbone, NORM="group")
    assert not any(key.endswith("running_mean") for key in grouped.state_dict())
