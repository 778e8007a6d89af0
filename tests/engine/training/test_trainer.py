"""One step: clipping, refusal of NaN, the schedule's point."""

import pytest
import torch

from pcdet_avp.errors import ConfigError, TrainingError


def test_a_nan_is_one_error_with_iteration_and_sensors_and_changes_nothing(toy):
    trainer = toy.make_trainer()
    source = toy.make_batches(trainer)
    trainer.step(next(source))
    before = [p.clone() for p in trainer.model.parameters()]
    batch = next(source) | {"loss_factor": float("nan")}
    with pytest.raises(TrainingError, match=rf"iteration 1, sensors {trainer.plan.combo(1).replace('+', '.')}: .*nan"):
        trainer.step(batch)
    assert all(torch.equal(a, b) for a, b in zip(before, trainer.model.parameters(), strict=True))
    assert trainer.iteration == 1


def test_an_infinite_gradient_is_refused_too(toy):
    trainer = toy.make_trainer()
    trainer.model.scale.register_hook(lambda grad: grad * float("inf"))
    with pytest.raises(TrainingError, match="the gradient's norm is"):
        trainer.step(next(toy.make_batches(trainer)))


def test_gradients_are_clipped_to_the_norm(toy):
    trainer = toy.make_trainer(GRAD_NORM_CLIP=0.01)
    report = trainer.step(next(toy.make_batches(trainer)))
    gradients = torch.cat([p.grad.flatten() for p in trainer.model.parameters() if p.grad is not None])
    assert report.grad_norm > 0.01
    assert gradients.norm().item() == pytest.approx(0.01, rel=1e-3)


def test_the_step_uses_the_schedules_point(toy):
    trainer = toy.make_trainer(planned=10)
    reports = [trainer.step(batch) for batch, _ in zip(toy.make_batches(trainer), range(10), strict=False)]
    assert [r.lr for r in reports] == [trainer.schedule.at(k)[0] for k in range(10)]
    assert [r.combo for r in reports] == [trainer.plan.combo(k) for k in range(10)]
    assert trainer.finished


def test_workers_deliver_the_same_batches(toy):
    trainer = toy.make_trainer()
    alone, helped = toy.make_batches(trainer, 0), toy.make_batches(trainer, 2)
    for _ in range(7):
        ours, theirs = next(alone), next(helped)
        assert torch.equal(ours["points"], theirs["points"])


def test_an_unknown_precision_is_refused(toy):
    from pcdet_avp.engine.training.trainer import Trainer

    trainer = toy.make_trainer()
    with pytest.raises(ConfigError, match="'fp8'; known: bf16, fp16"):
        Trainer(trainer.model, toy.OPTIMIZATION | {"AMP_DTYPE": "fp8"}, trainer.plan, 10, trainer.ranks, use_amp=True)


def test_reduced_precision_trains_with_full_precision_weights(toy):
    from pcdet_avp.engine.training.trainer import Trainer

    plain = toy.make_trainer()
    trainer = Trainer(toy.ToyNetwork(), toy.OPTIMIZATION, plain.plan, 10, plain.ranks, use_amp=True)
    trainer.step(next(toy.make_batches(trainer)))
    assert {p.dtype for p in trainer.model.parameters()} == {torch.float32}
