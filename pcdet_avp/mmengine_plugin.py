"""Our data set, network and metric in mmengine's registries, for its Runner and so for mmdetection3d's users.

Importing this module registers them; in a configuration of mmengine:

    custom_imports = dict(imports=["pcdet_avp.mmengine_plugin"])
    model = dict(type="AvpCp", cfg="cfgs/avp/cp_small.yaml")
    train_dataloader = dict(batch_size=2, num_workers=2, sampler=dict(type="DefaultSampler", shuffle=True),
                            collate_fn=dict(type="avp_collate"),
                            dataset=dict(type="AvpDataset", cfg="cfgs/avp/cp_small.yaml", training=True))
    val_evaluator = dict(type="AvpMetric", cfg="cfgs/avp/cp_small.yaml")

``cfg`` is a configuration of ours; mmengine's own schedules, hooks and launchers do the rest.
"""

from __future__ import annotations

from collections.abc import Sequence

from mmengine.evaluator import BaseMetric
from mmengine.model import BaseModel
from mmengine.registry import DATASETS, FUNCTIONS, METRICS, MODELS

from pcdet_avp.config import load_config
from pcdet_avp.datasets.avp.collate import load_batch
from pcdet_avp.datasets.avp.network_input import NetworkInput
from pcdet_avp.openpcdet.dataset import OpenPCDetAvpDataset
from pcdet_avp.openpcdet.detector import OpenPCDetAvpCp
from pcdet_avp.structures.sensor_set import SENSOR_SETS


@DATASETS.register_module(name="AvpDataset")
class MmAvpDataset(OpenPCDetAvpDataset):
    """Frames of the configuration's split; training draws one of ``sensor_sets`` for every sample."""

    def __init__(
        self,
        cfg: str,
        training: bool = False,
        data_path: str | None = None,
        sensor_sets: Sequence[str] = tuple(SENSOR_SETS),
        sensor_set: str | None = None,
    ) -> None:
        """``sensor_set`` is what a test uses, by default the configuration's SENSOR_SET."""
        ours = load_config(cfg)
        data_cfg = ours.DATA_CONFIG
        data_cfg.update(TRAIN_SENSOR_SETS=list(sensor_sets), SENSOR_SET=sensor_set or data_cfg.SENSOR_SET)
        data_cfg.DATA_PATH = data_path or data_cfg.DATA_PATH
        super().__init__(data_cfg, ours.CLASS_NAMES, training)


@FUNCTIONS.register_module()
def avp_collate(samples: Sequence[dict]) -> dict:
    """The keyword arguments of the network's ``forward``."""
    return {"inputs": OpenPCDetAvpDataset.collate_batch(samples)}


@MODELS.register_module(name="AvpCp")
class MmAvpCp(BaseModel):
    """``AvpCp`` as a model of mmengine."""

    def __init__(self, cfg: str, data_preprocessor: dict | None = None) -> None:
        super().__init__(data_preprocessor)
        ours = load_config(cfg)
        self.class_names = list(ours.CLASS_NAMES)
        network_input = NetworkInput.from_config(ours.DATA_CONFIG, self.class_names)
        self.network = OpenPCDetAvpCp(ours.MODEL, len(self.class_names), network_input)

    def forward(self, inputs: dict, mode: str = "predict") -> dict | list[dict]:
        """inputs: a collated batch. ``loss``: {"loss": scalar} and what it is made of; ``predict``: annotations."""
        batch_dict = load_batch(inputs, self.network.global_step.device)
        if mode != "loss":
            predictions, _ = self.network(batch_dict)
            return OpenPCDetAvpDataset.generate_prediction_dicts(batch_dict, predictions, self.class_names)
        losses, terms, _ = self.network(batch_dict)
        self.network.update_global_step()
        # mmengine adds up whatever has "loss" in its name
        return losses | {key.replace("loss", "part"): value.detach() for key, value in terms.items()}


@METRICS.register_module(name="AvpMetric")
class AvpMetric(BaseMetric):
    """Average precision over the split that the configuration tests on."""

    default_prefix = "avp"

    def __init__(self, cfg: str, data_path: str | None = None, **base) -> None:
        super().__init__(**base)
        self.dataset = MmAvpDataset(cfg, training=False, data_path=data_path)

    def process(self, data_batch: dict, data_samples: Sequence[dict]) -> None:
        """Keep the annotations of a batch."""
        self.results.extend(data_samples)

    def compute_metrics(self, results: list[dict]) -> dict[str, float]:
        """Numbers by name, in percent."""
        _, numbers = self.dataset.evaluation(results, self.dataset.class_names)
        return numbers
