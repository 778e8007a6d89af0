"""An exported network opened for a configuration: refused where its weights mean something else. Imports no torch."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pcdet_avp.deploy.deployed import Deployed
from pcdet_avp.deploy.manifest import MANIFEST, Exported
from pcdet_avp.deploy.network import Suppression
from pcdet_avp.deploy.runtime import open_runtime
from pcdet_avp.errors import ExportError
from pcdet_avp.link.map_size import MapSize
from pcdet_avp.models.thresholds import per_class
from pcdet_avp.models.weights.meaning import below, differences, meaning_of, some_of
from pcdet_avp.models.weights.refusal import refusal
from pcdet_avp.registration import RegistrationSettings
from pcdet_avp.structures.roadside_unit import last_number, mounted_units

logger = logging.getLogger(__name__)


def open_deployed(folder: Path, runtime: str, cfg: Mapping, threads: int | None = None) -> Deployed:
    """An exported network and its runtime; ExportError where it was exported for something else than ``cfg``.

    Keys and sections that MODEL.IGNORE_CONFIG names may differ, as for checkpoints. Boxes are filtered, and maps
    registered and limited in bytes, as ``cfg`` says: no weights depend on that.
    """
    exported = Exported.read(Path(folder))
    found = differences(exported.meaning, meaning_of(cfg))
    ignored = tuple(cfg["MODEL"].get("IGNORE_CONFIG") or ())
    refused = [one for one in found if not below(one.key, ignored)]
    if refused:
        raise ExportError(f"{folder}/{MANIFEST}: made with another configuration: {refusal(refused, exported.meaning)}")
    if found:
        logger.warning("%s: used although %s", folder, some_of(found))
    suppression = configured_suppression(cfg["MODEL"]["POST_PROCESSING"], exported.network.class_names)
    registration = RegistrationSettings.from_config(cfg["MODEL"])
    map_size = configured_map_size(cfg, exported)
    return Deployed(exported, open_runtime(runtime, threads), suppression, registration, map_size)


def configured_map_size(cfg: Mapping, exported: Exported) -> MapSize:
    """What a configuration allows the maps on the air; ConfigError where no map of the exported network fits it, or
    none of the site's last unit."""
    size = MapSize.from_config(cfg["MODEL"].get("COMPRESSION"))
    check_map_size(size, exported, last_number(mounted_units(cfg.get("DATA_CONFIG", {}).get("ROADSIDE_UNITS"))))
    return size


def check_map_size(size: MapSize, exported: Exported, sender: int, network: int = 0) -> None:
    """ConfigError where no map of the exported network fits ``size``; ``sender`` and ``network`` as in ``MapStamp``."""
    for precision in exported.network.latent_precision.values():
        size.check(exported.network.latent_shape, precision, sender, network)


def configured_suppression(cfg: Any, class_names: Sequence[str]) -> Suppression:
    """MODEL.POST_PROCESSING of a configuration, which no weights depend on."""
    nms = cfg["NMS_CONFIG"]
    scores = per_class(cfg["SCORE_THRESH"], class_names, "SCORE_THRESH")
    overlaps = per_class(nms["NMS_THRESH"], class_names, "NMS_CONFIG.NMS_THRESH")
    votes = per_class(nms.get("VOTE_IOU", 0.0), class_names, "NMS_CONFIG.VOTE_IOU")
    limits = int(nms["NMS_PRE_MAXSIZE"]), int(nms["NMS_POST_MAXSIZE"])
    return Suppression(tuple(scores), tuple(overlaps), *limits, tuple(votes))
