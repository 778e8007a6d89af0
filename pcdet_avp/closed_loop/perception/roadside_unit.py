"""A roadside unit's computer: from its own sensors to packets. It knows nothing of the vehicle or of other units."""

from __future__ import annotations

from pcdet_avp.closed_loop.perception.network import DrivingNetwork
from pcdet_avp.datasets.avp.collate import collate, load_batch
from pcdet_avp.datasets.avp.prepare import prepare
from pcdet_avp.models.detectors.split_inference import RoadsideHalf
from pcdet_avp.structures.frame import Frame
from pcdet_avp.structures.sensor_set import SensorSet


class RoadsideUnit:
    """Encodes, compresses and packs what a unit's sensors see; the units of a site, all alike, may share one object."""

    def __init__(self, driving: DrivingNetwork, max_segment_bytes: int) -> None:
        self._driving, self._half = driving, None
        if driving.deployed is not None:
            self._deployed = driving.deployed.roadside(max_segment_bytes)
        else:
            self._half = RoadsideHalf(driving.network, max_segment_bytes, asked_by="--perception model")

    def packets(self, frame: Frame, camera: bool, lidar: bool, number: int, sender: int = 0) -> dict[str, list[bytes]]:
        """{source: segments of its map} of the sensors in use; of the frame only the roadside's view is read.

        ``number`` is the frame id in the packets, ``sender`` the number of the unit.
        """
        sample = prepare(frame, SensorSet(False, False, camera, lidar), self._driving.input.prepare_config)
        stamp = (number, round(1e6 * frame.time_s), frame.infra.world_from_agent, sender)
        if self._half is None:
            return self._deployed.segments(sample, *stamp)
        batch_dict = load_batch(collate([sample]), self._driving.device)
        with self._driving.computing():
            return self._half.segments(batch_dict, *stamp)
