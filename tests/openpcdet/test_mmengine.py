"""Under the real mmengine, where it is installed (``pip install mmengine``): registered, trained, evaluated."""

from pathlib import Path

import pytest
import torch

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
