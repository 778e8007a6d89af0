"""Metrics: average precision as the paper counts it, and the benchmark table beside the paper's. numpy and numba only."""

from pcdet_avp.evaluation.inputs import Detections, GroundTruth, Region
from pcdet_avp.evaluation.summary import evaluate

__all__ = ["Detections", "GroundTruth", "Region", "evaluate"]
