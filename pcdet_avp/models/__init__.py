"""The paper's cooperative detector, stage by stage (torch). Importing this package imports nothing else."""

from typing import Any


def detects_objects(model_cfg: Any) -> bool:
    """Whether the configured network ends in boxes; ``CameraDepth`` ends in depths."""
    return getattr(_detector_class(model_cfg), "detects_objects", True)


def build_network(model_cfg: Any, num_class: int, dataset: Any):
    """The detector that ``MODEL.NAME`` names, as OpenPCDet's function of this name."""
    return _detector_class(model_cfg)(model_cfg=model_cfg, num_class=num_class, dataset=dataset)


def _detector_class(model_cfg: Any) -> type:
    from pcdet_avp.config import require
    from pcdet_avp.models import detectors  # noqa: F401 (enters its classes into the registry)
    from pcdet_avp.registry import DETECTORS

    return DETECTORS[require(model_cfg, "NAME", str)]
