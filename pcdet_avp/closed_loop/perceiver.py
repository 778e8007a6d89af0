"""The path under which perceptions were published; they live in ``closed_loop.perception``."""

from pcdet_avp.closed_loop.perception.factory import PERCEIVERS, build_perceiver
from pcdet_avp.closed_loop.perception.perceiver import (
    BASELINE,
    SENSORLESS,
    Message,
    Missed,
    Perceived,
    Perceiver,
    PerceiverSettings,
)

__all__ = [
    "BASELINE",
    "PERCEIVERS",
    "SENSORLESS",
    "Message",
    "Missed",
    "Perceived",
    "Perceiver",
    "PerceiverSettings",
    "build_perceiver",
]
