"""Our data set under OpenPCDet's loader, which knows neither our configuration's folder nor sensor combinations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcdet_avp import shipped
from pcdet_avp.config import require
from pcdet_avp.datasets.avp.avp_dataset import AvpDataset
from pcdet_avp.datasets.avp.manifest import MANIFEST_FILE
from pcdet_avp.errors import RecordError
from pcdet_avp.structures.sensor_set import SensorSet

EGO_IMAGES = "images_ego"  # (B, 3, h, w): OpenPCDet passes arrays under names that it does not know as they are
COMBINATION_STREAM = 1  # of the random numbers, beside the augmentation's


class OpenPCDetAvpDataset(AvpDataset):
    """``AvpDataset`` with what OpenPCDet lacks.

    DATA_PATH, if relative, is looked for where ``find_data`` says. TRAIN_SENSOR_SETS, a list of combinations: each
    training sample has one of them, drawn anew at every visit. The network takes mixed batches, since presence is a
    mask. Batches hold the ego's images as ``EGO_IMAGES``, because OpenPCDet hands ``images`` to kornia.
    """

    def __init__(self, dataset_cfg: Mapping, *args: Any, root_path: str | Path | None = None, **kwargs: Any) -> None:
        """Arguments are those of ``AvpDataset``; OpenPCDet passes everything by name."""
        root = root_path if root_path is not None else find_data(require(dataset_cfg, "DATA_PATH", str))
        super().__init__(dataset_cfg, *args, root_path=root, **kwargs)
        self.train_sets = [str(name) for name in dataset_cfg.get("TRAIN_SENSOR_SETS") or []]
        for name in self.train_sets:
            SensorSet.parse(name)

    def __getitem__(self, key: int | tuple) -> dict:
        if self.training and self.train_sets and not isinstance(key, tuple):
            key = (int(key), self._draw_combination(int(key)))
        return super().__getitem__(key)

    def _draw_combination(self, index: int) -> str:
        rng = np.random.default_rng([self.seed, int(self._visits[index]), index, COMBINATION_STREAM])
        return self.train_sets[int(rng.integers(len(self.train_sets)))]

    @staticmethod
    def collate_batch(batch_list: Sequence[dict], _unused: bool = False) -> dict:
        """``AvpDataset.collate_batch``'s batch, with ``EGO_IMAGES`` (B, 3, h, w) instead of images (B, h, w, 3)."""
        batch = AvpDataset.collate_batch(batch_list)
        batch[EGO_IMAGES] = np.ascontiguousarray(batch.pop("images").transpose(0, 3, 1, 2))
        return batch


def find_data(path: str, places: Sequence[Path] | None = None) -> Path:
    """The data set's folder: an absolute path as it is; a relative one below the working folder or our checkout."""
    places = [Path.cwd(), shipped.home()] if places is None else places
    candidates = list(
        dict.fromkeys((place / Path(path).expanduser()).resolve() for place in places)
    )  # an absolute path wins over places
    for candidate in candidates:
        if (candidate / MANIFEST_FILE).is_file():
            return candidate
    tried = " or ".join(str(candidate / MANIFEST_FILE) for candidate in candidates)
    raise RecordError(
        f"DATA_CONFIG.DATA_PATH {path}: there is no {tried}; make the data with tools/create_data.py, "
        "or name their folder: --set DATA_CONFIG.DATA_PATH DIR"
    )
