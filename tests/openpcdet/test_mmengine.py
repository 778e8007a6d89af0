"""Under the real mmengine, where it is installed (``pip install mmengine``): registered, trained, evaluated."""

from pathlib import Path

import pytest
import torch

from pcdet_avp.errors import CheckpointError, ConfigError

pytestmark = pytest.mark.slow
CFG = str(Path(__file__).parents[2] / "cfgs" / "avp" / "cp_tiny.yaml")


def test_one_epoch_and_an_evaluation_by_mmengines_runner(tiny_data, tmp_path):
    pytest.importorskip("mmengine", reason="mmengine is not installed")
    from mmengine.config import Config
    from mmengine.runner import Runner

    data = {"type": "AvpDataset", "cfg": CFG, "data_path": str(tiny_data)}
    loader = {"num_workers": 0, "collate_fn": {"type": "avp_collate"}}
    cfg = Config(
        {
            "custom_imports": {"imports": ["pcdet_avp.mmengine_plugin"]},
            "work_dir": str(tmp_path),
            "model": {"type": "AvpCp", "cfg": CFG},
            "train_dataloader": {
                **loader,
                "batch_size": 2,
                "sampler": {"type": "DefaultSampler", "shuffle": True},
                "dataset": {**data, "training": True},
            },
            "val_dataloader": {
                **loader,
                "batch_size": 1,
                "sampler": {"type": "DefaultSampler", "shuffle": False},
                "dataset": {**data, "sensor_set": "CL+none"},
            },
            "train_cfg": {"by_epoch": True, "max_epochs": 1, "val_interval": 1},
            "val_cfg": {},
            "val_evaluator": {"type": "AvpMetric", "cfg": CFG, "data_path": str(tiny_data)},
            "optim_wrapper": {"optimizer": {"type": "AdamW", "lr": 0.001}, "clip_grad": {"max_norm": 10}},
            "default_scope": "mmengine",
        }
    )
    from mmengine.utils import import_modules_from_strings

    import_modules_from_strings(**cfg.custom_imports)
    runner = Runner.from_cfg(cfg)
    before = {name: value.clone() for name, value in runner.model.state_dict().items()}
    runner.train()
    after = runner.model.state_dict()
    assert int(after["network.global_step"]) == 2
    assert any(not torch.equal(before[name], after[name]) for name in before if name.startswith("network.backbone_2d"))
    assert (tmp_path / "epoch_1.pth").exists()
    numbers = runner.val_loop.run()
    assert "avp/Car_overall_0.7" in numbers


@pytest.fixture(scope="module")
def plugin():
    pytest.importorskip("mmengine", reason="mmengine is not installed")
    from pcdet_avp import mmengine_plugin

    return mmengine_plugin


@pytest.fixture
def batch(plugin, tiny_data):
    data = plugin.MmAvpDataset(CFG, training=True, data_path=str(tiny_data))
    return plugin.avp_collate([data[0], data[1]])["inputs"]


def test_our_own_checkpoints_are_the_models_and_mmengines_loader_refuses_them(plugin, to_export):
    from mmengine.runner.checkpoint import load_state_dict

    from pcdet_avp.models.weights.checkpoint_file import read_checkpoint

    model = plugin.MmAvpCp(str(to_export.cfg_file), ckpt=str(to_export.path))
    for name, value in to_export.network.state_dict().items():
        assert torch.equal(model.network.state_dict()[name], value)
    with pytest.raises(CheckpointError, match=r"found model_state, .*ckpt=FILE"):
        load_state_dict(model, read_checkpoint(to_export.path), strict=False)
    load_state_dict(model, model.state_dict(), strict=False)


def test_data_and_network_of_different_configurations_are_told_apart(plugin, batch, tmp_path):
    other = tmp_path / "swapped.yaml"
    other.write_text(f"_BASE_CONFIG_: {CFG}\nCLASS_NAMES: [Pedestrian, Car]\n")
    with pytest.raises(ConfigError, match=r"CLASS_NAMES is \['Car', 'Pedestrian'\] in the data set's"):
        plugin.MmAvpCp(str(other)).train()(batch, mode="loss")


@pytest.mark.parametrize(("training", "mode"), [(True, "predict"), (False, "loss"), (True, "tensor")])
def test_a_mode_that_does_not_suit_the_network_is_named(plugin, batch, training, mode):
    with pytest.raises(ConfigError, match=f"found '{mode}' in {'training' if training else 'eval'}"):
        plugin.MmAvpCp(CFG).train(training)(batch, mode=mode)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"cfg": {"MODEL": 1}}, "expected the path of a file"),
        ({"cfg": CFG, "sensor_sets": "CL+CL"}, "expected a list of combinations, found 'CL\\+CL'"),
    ],
)
def test_arguments_that_mmengine_passes_on_are_checked(plugin, wrong, message):
    with pytest.raises(ConfigError, match=message):
        plugin.MmAvpDataset(**wrong)
