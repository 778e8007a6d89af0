"""The detector by itself: interface, presence, the link, losses, weights from files."""

import logging
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from pcdet_avp.errors import CheckpointError, ConfigError, GeometryError, RegistryError, SensorError
from pcdet_avp.models import build_network
from pcdet_avp.structures.sensor_set import SENSOR_SETS, SOURCES

LOGGER = logging.getLogger("test")


def same(a, b, tolerance=0.0):
    """Whether two lists of detections agree."""
    for one, other in zip(a, b, strict=True):
        assert one["pred_labels"].tolist() == other["pred_labels"].tolist()
        for key in ("pred_boxes", "pred_scores"):
            torch.testing.assert_close(one[key], other[key], atol=tolerance, rtol=tolerance)
    return True


def evaluate(network, batch, **link):
    with torch.no_grad():
        return network.eval()(batch, **link)[0]


def test_training_and_evaluation_speak_openpcdets_language(tiny):
    network, batch = tiny.network(), tiny.batch(["CL+CL", "C+none"])
    returned, terms, shown = network.train()(batch)
    assert returned["loss"].ndim == 0
    assert {"loss", "rpn_loss", "rpn_loss_cls", "loss_depth_ego_camera"} <= set(terms)
    assert shown == {}
    assert returned["loss"].item() == pytest.approx(float(terms["rpn_loss"]) + depth_losses(terms))
    found, recall = network.eval()(batch)
    assert [set(f) for f in found] == [{"pred_boxes", "pred_scores", "pred_labels"}] * 2
    assert len(found[0]["pred_boxes"]) > 0
    assert recall["gt"] == 4
    network.update_global_step()
    assert network.global_step.item() == 1


@pytest.mark.parametrize("count", [0, 1, 3, "2"])
def test_a_number_of_classes_that_is_not_the_data_sets_is_refused(count):
    dataset = SimpleNamespace(class_names=["Car", "Pedestrian"])
    with pytest.raises(ConfigError, match=rf"num_class: expected 2 \(Car, Pedestrian\), found {count!r}"):
        build_network({"NAME": "AvpCp"}, count, dataset)


def depth_losses(terms):
    return sum(float(value) for key, value in terms.items() if key.startswith("loss_depth"))


@pytest.mark.parametrize("combo", SENSOR_SETS)
def test_gradient_reaches_every_parameter_that_a_combination_uses(tiny, combo):
    network = tiny.network()
    network.train()(tiny.batch([combo, combo]))[0]["loss"].backward()
    used = [source for source, present in zip(SOURCES, SENSOR_SETS[combo].mask, strict=True) if present]
    for name, parameter in network.named_parameters():
        idle = name.startswith("encoders.") and name.split(".")[1] not in used
        idle |= name.startswith("codec.") and combo.endswith("none")
        idle |= name.startswith("fuser.channel.") and len(used) == 1  # one weight, normalised, is one
        if idle:
            assert parameter.grad is None or parameter.grad.abs().max() < 1e-6, name
        else:
            assert parameter.grad.isfinite().all(), name
            assert parameter.grad.any(), name


def test_every_parameter_sits_in_a_leaf_module(tiny):
    for module in tiny.network().modules():
        assert not list(module.children()) or not list(module.parameters(recurse=False))


def test_a_batch_of_all_combinations_equals_the_single_runs(tiny):
    network, batch = tiny.network(), tiny.batch(list(SENSOR_SETS))
    together = evaluate(network, batch)
    alone = [evaluate(network, tiny.select(batch, i))[0] for i in range(len(SENSOR_SETS))]
    assert same(together, alone, 1e-5)


def test_a_lost_roadside_leaves_exactly_what_infra_none_computes(tiny):
    """Sensors absent; packets lost on the link; the mast out of range: the same bits."""
    network, full = tiny.network(), tiny.batch(["CL+CL"])
    alone = {**full, "source_present": torch.tensor([[1.0, 1, 0, 0]])}
    expected = evaluate(network, alone)
    assert not torch.equal(expected[0]["pred_scores"], evaluate(network, full)[0]["pred_scores"])
    assert torch.equal(expected[0]["pred_boxes"], evaluate(network, tiny.batch(["CL+none"]))[0]["pred_boxes"])
    assert same(expected, evaluate(network, full, link=lambda latents: {}))
    far = full["ego_from_infra"].clone()
    far[:, 0, 3] = 500.0
    assert same(expected, evaluate(network, {**full, "ego_from_infra": far}))


def test_the_link_decides_what_the_vehicle_gets(tiny):
    network, batch = tiny.network(), tiny.batch(["CL+CL"])
    sent = []

    def only_the_camera(latents):
        sent.extend(latents)
        return {"infra_camera": latents["infra_camera"]}

    received = evaluate(network, batch, link=only_the_camera)
    assert sent == ["infra_camera", "infra_lidar"]
    assert same(received, evaluate(network, {**batch, "source_present": torch.tensor([[1.0, 1, 1, 0]])}))


def test_shared_encoders_serve_both_agents(tiny):
    own, shared = tiny.network(), tiny.network(SHARE_ENCODERS=True)
    assert list(own.encoders) == list(SOURCES)
    assert list(shared.encoders) == ["camera", "lidar"]
    assert shared.encoder_of("infra_lidar") is shared.encoder_of("ego_lidar")
    shared.train()(tiny.batch(["CL+CL"]))[0]["loss"].backward()


def test_training_loses_roadside_maps_and_evaluation_does_not(tiny):
    network, batch = tiny.network(ROADSIDE_MAP_DROPOUT=1.0), tiny.batch(["CL+CL"])
    assert set(network.train().run_stages(batch)["bev_maps"]) == set(SOURCES[:2])
    assert set(network.eval().run_stages(batch)["bev_maps"]) == set(SOURCES)


def test_norm_is_chosen_in_one_place(tiny):
    batch_norm = tiny.network(NORM="batch")
    assert "backbone_2d.blocks.0.2.running_mean" in batch_norm.state_dict()
    assert "backbone_2d.blocks.0.2.running_mean" not in tiny.network().state_dict()


def test_weights_survive_a_file(tiny, tmp_path):
    path = tmp_path / "checkpoint.pth"
    first, second, batch = tiny.network(0), tiny.network(1), tiny.batch(["CL+CL"])
    optimizer = torch.optim.SGD(first.parameters(), lr=0.1, momentum=0.9)
    content = {"model_state": first.state_dict(), "optimizer_state": optimizer.state_dict(), "it": 5, "epoch": 2}
    torch.save(content, path)
    second.load_params_from_file(path, LOGGER, to_cpu=True)
    assert same(evaluate(first, batch), evaluate(second, batch))
    third = tiny.network(2)
    assert third.load_params_with_optimizer(path, to_cpu=True, optimizer=optimizer, logger=LOGGER) == (5, 2)
    assert same(evaluate(first, batch), evaluate(third, batch))


def test_a_checkpoint_of_another_configuration_names_the_first_shape(tiny, tmp_path):
    path = tmp_path / "other.pth"
    wide = tiny.config()
    wide.BACKBONE_2D.NUM_FILTERS = [12, 16]
    torch.save({"model_state": tiny.network(BACKBONE_2D=wide.BACKBONE_2D).state_dict()}, path)
    with pytest.raises(CheckpointError, match=r"backbone_2d\.blocks\.0\.1\.weight has shape \(12, 4, 3, 3\)"):
        tiny.network().load_params_from_file(path, LOGGER)


def test_further_training_begins_tensors_of_another_shape_anew_and_says_so(tiny, tmp_path, caplog):
    path = tmp_path / "other.pth"
    wide = tiny.config()
    wide.BACKBONE_2D.NUM_FILTERS = [12, 16]
    torch.save({"model_state": tiny.network(1, BACKBONE_2D=wide.BACKBONE_2D).state_dict()}, path)
    theirs, fresh = torch.load(path)["model_state"], tiny.network(2).state_dict()
    network = tiny.network(2)
    network.meaning = replace(network.meaning, training=True)
    network.load_params_from_file(path, LOGGER)
    same_shape = {key for key in fresh if theirs[key].shape == fresh[key].shape}
    assert "backbone_2d.blocks.0.1.weight" not in same_shape
    for key, value in network.state_dict().items():
        assert torch.equal(value, (theirs if key in same_shape else fresh)[key]), key
    assert f"{len(fresh) - len(same_shape)} tensors are of another shape, not loaded: backbone_2d" in caplog.text
    assert "missing" not in caplog.text


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_a_truncated_checkpoint_is_one_error(tiny, tmp_path, share):
    path = tmp_path / "cut.pth"
    torch.save({"model_state": tiny.network().state_dict()}, path)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(CheckpointError, match=r"cut\.pth"):
        tiny.network().load_params_from_file(path, LOGGER)


def test_foreign_files_are_no_checkpoints(tiny, tmp_path):
    path = tmp_path / "foreign.pth"
    stranger = {"model_state": {"a": torch.zeros(1)}}
    for content, message in (([1, 2], "model_state"), (stranger, "none of its 1 tensors")):
        torch.save(content, path)
        with pytest.raises(CheckpointError, match=message):
            tiny.network().load_params_from_file(path, LOGGER)
    with pytest.raises(CheckpointError, match=r"nowhere\.pth"):
        tiny.network().load_params_from_file(tmp_path / "nowhere.pth", LOGGER)


def test_batch_norm_weights_are_not_poured_into_group_norm(tiny, tmp_path, caplog):
    path = tmp_path / "batch.pth"
    source = tiny.network(NORM="batch")
    torch.nn.init.constant_(source.backbone_2d.blocks[0][2].weight, 7.0)
    torch.save({"model_state": source.state_dict()}, path)
    network = tiny.network()
    network.load_params_from_file(path, LOGGER)
    assert (network.backbone_2d.blocks[0][2].weight == 1).all()
    assert torch.equal(network.backbone_2d.blocks[0][1].weight, source.backbone_2d.blocks[0][1].weight)
    assert "another normalisation" in caplog.text


def test_bad_input_is_named(tiny):
    network, batch = tiny.network(), tiny.batch(["CL+CL", "C+C"])
    blind = {**batch, "source_present": batch["source_present"] * torch.tensor([[1.0], [0.0]])}
    with pytest.raises(SensorError, match="0000/001"):
        network(blind)
    flat = {**batch, "gt_boxes": batch["gt_boxes"].clone()}
    flat["gt_boxes"][0, 0, 5] = 0
    with pytest.raises(GeometryError, match="positive"):
        network.train()(flat)
    with pytest.raises(RegistryError, match=r"known: .*AdaFusion"):
        tiny.network(FUSER={"NAME": "MagicFusion"})
    with pytest.raises(RegistryError, match="AvpCp"):
        tiny.network(NAME="AvpCP")


def test_two_samples_are_learned_by_heart(tiny):
    """A few steps of Adam on two samples put a confident box on the car, in the right direction."""
    network, batch = tiny.network(), tiny.batch(["CL+CL", "CL+none"])
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-2)
    network.train()
    losses = []
    for _ in range(100):
        optimizer.zero_grad()
        loss = network(batch)[0]["loss"]
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.1 * losses[0]
    for found, truth in zip(evaluate(network, batch), batch["gt_boxes"], strict=True):
        car = found["pred_boxes"][found["pred_labels"] == 1][0]
        torch.testing.assert_close(car, truth[0, :7], atol=0.25, rtol=0)
