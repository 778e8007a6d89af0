"""An exported network that is ready to run: its files and who computes them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pcdet_avp.deploy.halves import Received, RoadsideHalf, Sample, VehicleHalf
from pcdet_avp.deploy.manifest import Exported
from pcdet_avp.deploy.network import Suppression
from pcdet_avp.deploy.post_processing import Detected
from pcdet_avp.deploy.runtime import Runtime
from pcdet_avp.link.map_size import UNLIMITED, MapSize
from pcdet_avp.link.nr_v2x import NrV2xConfig
from pcdet_avp.registration import RegistrationSettings


@dataclass(frozen=True, eq=False)
class Deployed:
    """Makes the two halves, each with graphs of its own.

    ``suppression``: thresholds of the vehicle's half in place of those that were exported. ``registration``: how the
    vehicle registers received maps; None: it does not. ``map_size``: what the roadside's maps may take on the air, in
    place of what was exported.
    """

    exported: Exported
    runtime: Runtime
    suppression: Suppression | None = None
    registration: RegistrationSettings | None = None
    map_size: MapSize | None = None

    def roadside(self, max_segment_bytes: int, budget_bytes: int | None = None) -> RoadsideHalf:
        """What runs at the mast. ``budget_bytes``: what a map may take where ``sent_size`` allows more."""
        return RoadsideHalf(self.exported, self.runtime, max_segment_bytes, self.sent_size.within(budget_bytes))

    @property
    def sent_size(self) -> MapSize:
        """What the roadside's maps may take on the air."""
        return self.map_size or self.exported.network.map_size

    def vehicle(self, follows_time: bool = False) -> VehicleHalf:
        """What runs in the vehicle; ``follows_time``: on frames of one vehicle, one after the other."""
        return VehicleHalf(self.exported, self.runtime, self.suppression, self.registration, follows_time)

    @property
    def name(self) -> str:
        """``onnxruntime 1.32.0``"""
        return f"{self.runtime.name} {self.runtime.version}"


class BothHalves:
    """Both halves in one process, for tests and tables: maps are handed over as arrays, not as bytes."""

    def __init__(self, deployed: Deployed) -> None:
        no_bytes = (NrV2xConfig().max_segment_bytes, UNLIMITED)
        self._roadside = RoadsideHalf(deployed.exported, deployed.runtime, *no_bytes)
        self._vehicle = deployed.vehicle()

    def latents(self, sample: Sample) -> dict[str, np.ndarray]:
        """By source, the compressed map (c, h, w) of each roadside sensor that the sample has."""
        return self._roadside.latents(sample)

    def detect(self, sample: Sample, latents: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> Detected:
        """Detections from the vehicle's sensors and, by source, what arrived: values (c, h, w), present (h, w) bool."""
        pose = np.asarray(sample["ego_from_infra"])
        received = {source: Received(values, present, pose) for source, (values, present) in latents.items()}
        return self._vehicle.post_process(self._vehicle.run(sample, received))

    def detect_alone(self, sample: Sample) -> Detected:
        """Detections where every map arrives whole."""
        latents = self.latents(sample)
        return self.detect(sample, {source: (one, np.ones(one.shape[1:], bool)) for source, one in latents.items()})
