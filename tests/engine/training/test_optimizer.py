"""Adam with decoupled decay over everything."""

import logging
from pathlib import Path

import pytest
import torch

from pcdet_avp.config import load_config
from pcdet_avp.engine.training.optimizer import build_optimizer, load_moments, set_point
from pcdet_avp.engine.training.run import warn_of_slow_parts
from pcdet_avp.errors import ConfigError


def test_every_parameter_is_trained_bare_ones_included(toy):
    model = toy.ToyNetwork()
    held = {id(p) for group in build_optimizer(model, toy.OPTIMIZATION).param_groups for p in group["params"]}
    assert held == {id(p) for p in model.parameters()}
    assert id(model.scale) in held


def test_first_step_is_decay_then_the_rate_against_the_gradients_sign(toy):
    # Adam's first step is -lr * g / |g|, whatever the betas; decoupled decay multiplies by 1 - lr * decay before.
    model = torch.nn.Linear(1, 1)
    torch.nn.init.constant_(model.weight, 2.0)
    torch.nn.init.constant_(model.bias, -3.0)
    optimizer = build_optimizer(model, toy.OPTIMIZATION | {"WEIGHT_DECAY": 0.1})
    set_point(optimizer, 0.01, 0.85)
    model.weight.grad, model.bias.grad = torch.tensor([[5.0]]), torch.tensor([-0.5])
    optimizer.step()
    assert model.weight.item() == pytest.approx(2.0 * (1 - 0.001) - 0.01, abs=1e-6)
    assert model.bias.item() == pytest.approx(-3.0 * (1 - 0.001) + 0.01, abs=1e-6)


def test_the_schedule_moves_the_first_beta_only(toy):
    optimizer = build_optimizer(toy.ToyNetwork(), toy.OPTIMIZATION)
    set_point(optimizer, 0.5, 0.9)
    assert optimizer.param_groups[0]["betas"] == (0.9, 0.99)


def test_a_parameter_without_gradient_stays_as_it_is(toy):
    trainer = toy.make_trainer()
    camera_only = {"points": torch.ones(2, 4), "source_present": torch.tensor([[1.0, 0.0]] * 2)}
    before = trainer.model.lidar.weight.clone()
    trainer.step(camera_only)
    assert torch.equal(trainer.model.lidar.weight, before)


def test_an_unknown_optimizer_is_named_with_the_known(toy):
    with pytest.raises(ConfigError, match="'sgd'; known: adam_onecycle"):
        build_optimizer(toy.ToyNetwork(), toy.OPTIMIZATION | {"OPTIMIZER": "sgd"})


def test_factors_slow_the_longest_prefix_down_and_nought_freezes(toy):
    model = toy.ToyNetwork()
    optimizer = build_optimizer(
        model, toy.OPTIMIZATION | {"LR_FACTORS": {"camera": 0.3, "camera.bias": 0, "lidar": 0.3}}
    )
    set_point(optimizer, 0.01, 0.85)
    rates = {id(p): group["lr"] for group in optimizer.param_groups for p in group["params"]}
    expected = {"camera.weight": 0.003, "lidar.weight": 0.003, "lidar.bias": 0.003, "scale": 0.01}
    assert {n: pytest.approx(rates[id(p)]) for n, p in model.named_parameters() if id(p) in rates} == expected
    assert [name for name, p in model.named_parameters() if not p.requires_grad] == ["camera.bias"]


def test_a_frozen_part_stays_and_the_rest_learns(toy):
    trainer = toy.make_trainer(LR_FACTORS={"camera": 0})
    before = {name: p.detach().clone() for name, p in trainer.model.named_parameters()}
    trainer.step({"points": torch.ones(2, 4), "source_present": torch.ones(2, 2)})
    moved = [name for name, p in trainer.model.named_parameters() if not torch.equal(p, before[name])]
    assert moved == ["scale", "lidar.weight", "lidar.bias"]


def test_moments_of_a_checkpoint_without_factors_are_taken_up(toy):
    optimizer = build_optimizer(toy.ToyNetwork(), toy.OPTIMIZATION)
    state = optimizer.state_dict()
    del state["param_groups"][0]["factor"]
    load_moments(optimizer, state)
    set_point(optimizer, 0.5, 0.9)
    assert optimizer.param_groups[0]["lr"] == 0.5


@pytest.mark.parametrize(
    ("factors", "message"),
    [
        ({"cammera": 0.3}, "no parameter is within 'cammera'; there are camera.bias"),
        ({"came": 0.3}, "no parameter is within 'came'"),
        ({"camera": 0, "lidar": 0, "scale": 0}, "nothing is left to train"),
    ],
)
def test_factors_that_fit_nothing_or_freeze_all_are_refused(toy, factors, message):
    with pytest.raises(ConfigError, match=message):
        build_optimizer(toy.ToyNetwork(), toy.OPTIMIZATION | {"LR_FACTORS": factors})


@pytest.mark.parametrize(
    ("name", "slow"), [("cp_small", True), ("cp_small_scratch", False), ("cp_small_depth", False), ("cp_tiny", False)]
)
def test_parts_that_learn_slowly_from_scratch_are_named(caplog, name, slow):
    cfg = load_config(Path(__file__).parents[3] / "cfgs" / "avp" / f"{name}.yaml")
    with caplog.at_level(logging.WARNING):
        warn_of_slow_parts(cfg.OPTIMIZATION, logging.getLogger("test"))
    assert ("LR_FACTORS slows encoders.ego_camera.image_backbone, encoders." in caplog.text) == slow
    assert bool(caplog.text) == slow
