"""The data set class: OpenPCDet's constructor, attributes and methods over records on disk."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from pcdet_avp.config import require
from pcdet_avp.datasets.avp.augment import Augmentor
from pcdet_avp.datasets.avp.collate import collate
from pcdet_avp.datasets.avp.doubts import doubts
from pcdet_avp.datasets.avp.frames import find_frames
from pcdet_avp.datasets.avp.manifest import read_manifest
from pcdet_avp.datasets.avp.network_input import NetworkInput
from pcdet_avp.datasets.avp.prepare import prepare
from pcdet_avp.datasets.avp.record import read_frame, recorded_sources
from pcdet_avp.datasets.avp.splits import protocol_of
from pcdet_avp.errors import ConfigError, RecordError
from pcdet_avp.evaluation import Detections, GroundTruth, Region, evaluate
from pcdet_avp.evaluation.detections_file import write_texts
from pcdet_avp.registry import DATASETS
from pcdet_avp.structures.ego import centre_in_ego
from pcdet_avp.structures.frame import Frame
from pcdet_avp.structures.sensor_set import SOURCES, SensorSet

UNSET_EPOCH = -1


@DATASETS.register("AvpDataset")
class AvpDataset(torch.utils.data.Dataset):
    """Frames of one split, as samples.

    A sample is what ``prepare`` documents. Its steps: read the sensors in use from disk, augment the frame (when
    training), prepare. Index with an integer, for the sensors of DATA_CONFIG.SENSOR_SET, or with
    ``(integer, "C+CL")``, so that absent sensors are not even read, or with ``(integer, "C+CL", epoch)``: then the
    augmentation is the epoch's, whatever ``set_epoch`` says (workers may prefetch beyond the present epoch).
    """

    def __init__(
        self,
        dataset_cfg: Mapping,
        class_names: Sequence[str],
        training: bool = True,
        root_path: str | Path | None = None,
        logger: logging.Logger | None = None,
        split: str | None = None,
        needs_labels: bool = True,
    ) -> None:
        """``needs_labels=False``: for pictures, frames whose labels lack one of ``class_names`` will do."""
        self.needs_labels = needs_labels
        self.dataset_cfg, self.training, self.logger = dataset_cfg, training, logger
        self.root_path = Path(root_path if root_path is not None else require(dataset_cfg, "DATA_PATH", str))
        self.split = split or require(dataset_cfg, f"DATA_SPLIT.{self.mode}", str)
        self.sensor_set = SensorSet.parse(require(dataset_cfg, "SENSOR_SET", str))
        self.roadside_unit: str | None = dataset_cfg.get("ROADSIDE_UNIT")  # None: the first one of each record
        self.sources: Sequence[str] = SOURCES  # that may be read at all: a network may use fewer than a combination has
        network_input = NetworkInput.from_config(dataset_cfg, class_names)
        self.prepare_config = network_input.prepare_config
        # The attributes that OpenPCDet's detectors read back; NetworkInput says what they hold.
        self.class_names = network_input.class_names
        self.point_cloud_range = network_input.point_cloud_range
        self.voxel_size = network_input.voxel_size
        self.grid_size = network_input.grid_size
        self.depth_downsample_factor = network_input.depth_downsample_factor
        self.point_feature_encoder = network_input.point_feature_encoder
        self.frame_ids = self._find_frames()
        self.data_augmentor = Augmentor(dataset_cfg.get("DATA_AUGMENTOR")) if training else None
        self.seed = int((dataset_cfg.get("DATA_AUGMENTOR") or {}).get("SEED", 0))
        # Shared memory: workers that were started earlier see what the main process sets, and count together.
        self._epoch = torch.full((), UNSET_EPOCH, dtype=torch.int64).share_memory_()
        self._visits = torch.zeros(len(self.frame_ids), dtype=torch.int64).share_memory_()

    def __getstate__(self) -> dict:
        """State for another process, whatever started it: everything but the log, which is this process's."""
        return self.__dict__ | {"logger": None}

    def _find_frames(self) -> list[str]:
        names = self.class_names if self.needs_labels else self._labelled()
        frame_ids = find_frames(self.root_path, self.dataset_cfg, names, self.split)
        self._check_first_frame(frame_ids[0])
        if self.logger is not None:
            by = protocol_of(self.dataset_cfg)
            self.logger.info("%s: %d frames in split %s, split by %s", self.root_path, len(frame_ids), self.split, by)
        return frame_ids

    def _labelled(self) -> list[str]:
        """Those of the classes that the data set labels; the log names the others."""
        there = read_manifest(self.root_path).class_names
        missing = [name for name in self.class_names if name not in there]
        if missing and self.logger is not None:
            self.logger.warning(f"{self.root_path}: has no labels of {', '.join(missing)}: the truth shows none")
        return [name for name in self.class_names if name in there]

    def _check_first_frame(self, frame_id: str) -> None:
        labels = read_frame(self.root_path, frame_id, sources=(), keep_ego=True, unit=self.roadside_unit).labels
        if self.logger is not None and centre_in_ego(labels.boxes).any():
            self.logger.warning(f"{self.root_path}: the ego itself is among the labels (frame {frame_id}): left out")
        if self.logger is not None and "GENERATE" not in read_manifest(self.root_path).generator:
            with suppress(RecordError):  # of a sensor that may never be used
                for doubt in doubts(read_frame(self.root_path, frame_id, unit=self.roadside_unit)):
                    self.logger.warning(f"{self.root_path}: frame {frame_id}: {doubt}")

    @property
    def mode(self) -> str:
        """'train' or 'test': the key of DATA_SPLIT that counts."""
        return "train" if self.training else "test"

    def __len__(self) -> int:
        return len(self.frame_ids)

    def __getitem__(self, key: int | tuple[int, str] | tuple[int, str, int]) -> dict:
        index, sensor_set = (key[0], SensorSet.parse(key[1])) if isinstance(key, tuple) else (key, self.sensor_set)
        index = range(len(self))[index]  # from the end where it is negative; IndexError and TypeError as of a list
        epoch = key[2] if isinstance(key, tuple) and len(key) == 3 else None
        frame = self.read(int(index), sensor_set)
        if self.data_augmentor is not None:
            frame = self.data_augmentor(frame, self._augmentation_rng(int(index), epoch))
        return prepare(frame, sensor_set, self.prepare_config)

    def read(self, index: int, sensor_set: SensorSet) -> Frame:
        """The frame as recorded, with the data of the sensors in ``sensor_set``.

        Of several roadside units it has the one that DATA_CONFIG.ROADSIDE_UNIT names, else the first; RecordError where
        a record has none of this name. ``read_record`` of ``self.root_path`` has them all.
        """
        sources = [source for source in sensor_set.sources if source in self.sources]
        return read_frame(self.root_path, self.frame_ids[index], sources, unit=self.roadside_unit)

    def read_labels(self, index: int, keep_ego: bool = False) -> Frame:
        """The frame without any sensor data: poses, calibration and labels."""
        return read_frame(self.root_path, self.frame_ids[index], (), keep_ego, self.roadside_unit)

    @cached_property
    def recorded_sources(self) -> tuple[str, ...]:
        """The sensors that any frame of the split has data of, in the order of ``SOURCES``."""
        found: set[str] = set()
        for frame_id in self.frame_ids:
            found |= recorded_sources(self.root_path, frame_id, self.roadside_unit)
            if len(found) == len(SOURCES):
                break
        return tuple(source for source in SOURCES if source in found)

    def set_epoch(self, epoch: int) -> None:
        """Augmentation depends on (seed, epoch, index); until this is called, the epoch is a frame's visit count."""
        if epoch < 0:
            raise ConfigError(f"epoch must not be negative, found {epoch}")
        self._epoch.fill_(epoch)

    def _augmentation_rng(self, index: int, epoch: int | None = None) -> np.random.Generator:
        epoch = int(self._epoch) if epoch is None else epoch
        if epoch == UNSET_EPOCH:
            epoch = int(self._visits[index])
            self._visits[index] += 1
        return np.random.default_rng([self.seed, epoch, index])

    @staticmethod
    def collate_batch(batch_list: Sequence[dict], _unused: bool = False) -> dict:
        """See ``collate.collate``."""
        return collate(batch_list)

    @staticmethod
    def generate_prediction_dicts(
        batch_dict: Mapping, pred_dicts: Sequence[Mapping], class_names: Sequence[str], output_path=None
    ) -> list[dict]:
        """One dictionary per sample: frame_id, name (n,), score (n,), boxes_lidar (n, 7), pred_labels (n,) from 1.

        ``pred_dicts`` hold tensors pred_boxes, pred_scores, pred_labels. With ``output_path``, each frame is also
        written there as text: name, score and box, one detection a line.
        """
        annotations = []
        for frame_id, prediction in zip(batch_dict["frame_id"], pred_dicts, strict=True):
            labels, scores, boxes = (
                prediction[key].detach().cpu().numpy() for key in ("pred_labels", "pred_scores", "pred_boxes")
            )
            names = np.array(class_names)[labels.astype(int) - 1]
            annotation = {"frame_id": str(frame_id), "name": names, "score": scores, "boxes_lidar": boxes}
            annotations.append(annotation | {"pred_labels": labels})
            if output_path is not None:
                write_texts(Path(output_path), [Detections.from_annotation(annotation)])
        return annotations

    def evaluation(
        self,
        det_annos: Sequence[Mapping],
        class_names: Sequence[str],
        eval_metric: str | None = None,
        output_path: str | Path | None = None,
        min_scores: Mapping[str, float] | None = None,
    ) -> tuple[str, dict[str, float]]:
        """Average precision over all frames of the split: a text, and numbers by name (percent).

        ``det_annos`` as from ``generate_prediction_dicts``; every frame of the split must be there. There is one
        metric and nothing is written, so ``eval_metric`` and ``output_path``, which OpenPCDet passes, change nothing.
        ConfigError for class names that are not the data set's.
        """
        if isinstance(class_names, str) or not {*class_names} <= {*self.class_names}:
            raise ConfigError(f"class_names: expected some of {', '.join(self.class_names)}, found {class_names!r}")
        by_frame = {str(annotation["frame_id"]): annotation for annotation in det_annos}
        truths = self.ground_truths()
        detections = [Detections.from_annotation(by_frame[t.frame_id]) for t in truths if t.frame_id in by_frame]
        return evaluate(truths, detections, self.regions(), class_names, min_scores)

    def ground_truths(self) -> list[GroundTruth]:
        """The labels of every frame of the split, in order, without the ego itself; the log counts those left out."""
        truths, left_out = [], 0
        for index, frame_id in enumerate(self.frame_ids):
            frame = self.read_labels(index, keep_ego=True)
            ego = centre_in_ego(frame.labels.boxes)
            left_out += int(ego.sum())
            truths.append(GroundTruth.from_labels(frame_id, frame.labels.select(~ego), frame.ego.camera))
        if left_out and self.logger is not None:
            self.logger.warning(f"{self.root_path}: split {self.split}: {left_out} labels of the ego itself left out")
        return truths

    def regions(self) -> list[Region]:
        """Regions in which objects count: each frame's own camera's field of view first, then the whole range."""
        grid = self.prepare_config.grid
        cameras = (self.read_labels(index).ego.camera for index in range(len(self)))
        if all(camera is None for camera in cameras):
            return [Region.full_range(grid)]
        return [Region.own_camera_fov(grid), Region.full_range(grid)]
