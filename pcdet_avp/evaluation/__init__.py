"""Metrics: average precision as the paper counts it, and the benchmark table. numpy and numba, no torch."""

from pcdet_avp.evaluation.benchmark_table import benchmark_rows, render
from pcdet_avp.evaluation.bootstrap import Gain, bootstrap_gain
from pcdet_avp.evaluation.inputs import Detections, GroundTruth, Region
from pcdet_avp.evaluation.summary import evaluate, score_thresholds

__all__ = [
    "Detections",
    "Gain",
    "GroundTruth",
    "Region",
    "benchmark_rows",
    "bootstrap_gain",
    "evaluate",
    "render",
    "score_thresholds",
]
