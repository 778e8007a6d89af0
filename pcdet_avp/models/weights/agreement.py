"""Whether the weights in a file mean what the network takes them for: refused by name, unless the user insists."""

from __future__ import annotations

import difflib
import json
import logging
import os
from collections.abc import Collection, Iterable, Mapping, MutableMapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from pcdet_avp.errors import CheckpointError, ConfigError
from pcdet_avp.models.weights.meaning import (
    CODE_KEY,
    DEFAULTS,
    Difference,
    below,
    differences,
    meaning_of,
    some_of,
)
from pcdet_avp.models.weights.refusal import refusal

MEANING_KEY = "meaning"  # of a checkpoint: what its weights mean, see ``meaning_of``
IGNORE_KEY = "IGNORE_CONFIG"  # of MODEL: keys and sections in which a checkpoint may differ; --ignore_config sets it
CARRIED = "_extra_state"  # name that torch gives to what a module stores beside its tensors


@dataclass(frozen=True, eq=False)
class NetworkMeaning:
    """What a network takes its weights for, where a file may differ, and whether it is to be trained further.

    Training makes good what changes inputs (other sensors, another range, another codec): such differences are a
    warning there, and an error where the weights are used as they are. ``sections``: of a part of a whole network,
    the keys that it depends on.
    """

    values: Mapping[str, Any]
    ignored: tuple[str, ...] = ()
    training: bool = False
    sections: tuple[str, ...] | None = None

    @classmethod
    def of(cls, model_cfg: Any, dataset: Any, sections: tuple[str, ...] | None = None) -> NetworkMeaning:
        """``dataset`` tells class_names and, if it has them, dataset_cfg (DATA_CONFIG) and training."""
        cfg = {"CLASS_NAMES": list(dataset.class_names), "MODEL": model_cfg}
        dataset_cfg = getattr(dataset, "dataset_cfg", None)
        values = meaning_of(cfg if dataset_cfg is None else {**cfg, "DATA_CONFIG": dataset_cfg})
        ignored = tuple(model_cfg.get(IGNORE_KEY) or ())
        return cls(values, ignored, bool(getattr(dataset, "training", False)), sections)

    def depends_on(self, difference: Difference, tensors: Collection[str]) -> bool:
        """Whether a network of these tensors, by name, takes notice of it."""
        return self.sections is None or (below(difference.key, self.sections) and difference.concerns(tensors))


def meaning_in(content: Mapping[str, Any]) -> dict[str, Any] | None:
    """What the weights of a checkpoint mean; files without it tell it by the configuration that they hold, if any."""
    if content.get(MEANING_KEY):
        return dict(content[MEANING_KEY])
    if content.get("config"):
        return meaning_of(content["config"]) | {CODE_KEY: DEFAULTS[CODE_KEY]}
    return None


def as_tensor(meaning: Mapping[str, Any]) -> Tensor:
    """A meaning as uint8 (n,), to travel among a network's tensors where others write its checkpoints."""
    return torch.frombuffer(bytearray(json.dumps(meaning).encode()), dtype=torch.uint8)


def from_tensor(state: Tensor) -> dict[str, Any]:
    """What ``as_tensor`` was given; ValueError where it is something else."""
    return json.loads(bytes(state.detach().cpu().tolist()))


def take_carried_meaning(state: MutableMapping[str, Any]) -> dict[str, Any] | None:
    """Remove a meaning that travels among the tensors, and return it."""
    carried = [state.pop(key) for key in list(state) if key.rpartition(".")[2] == CARRIED]
    return from_tensor(carried[0]) if carried else None


def check_meaning(
    network: nn.Module, content: Mapping[str, Any], path: str | os.PathLike, logger: logging.Logger
) -> None:
    """CheckpointError where the file's weights would be taken for something else; a warning where it does not say.

    A network without a ``meaning`` takes any file.
    """
    ours = getattr(network, "meaning", None)
    if ours is None:
        return
    theirs = meaning_in(content)
    if theirs is None:
        logger.warning("%s: does not say what its weights mean: nothing but their shapes could be checked", path)
        return
    own = network.state_dict()
    found = [one for one in differences(theirs, ours.values) if ours.depends_on(one, own)]
    _check_ignored(ours.ignored, {*theirs, *ours.values})
    if refused := [one for one in found if not _accepted(one, ours, content["model_state"])]:
        raise foreign_weights(path, refusal(refused, theirs))
    if found:
        logger.warning("%s: used although %s", path, some_of(found))


def _accepted(difference: Difference, ours: NetworkMeaning, tensors: Collection[str]) -> bool:
    if below(difference.key, ours.ignored):
        return True
    return ours.training and not (difference.scrambles and difference.concerns(tensors))


def foreign_weights(path: str | os.PathLike, difference: str) -> CheckpointError:
    """The error for a file whose weights belong to another configuration than the network's."""
    return CheckpointError(f"{path}: made with another configuration: {difference}")


def check_shape(key: str, found: tuple[int, ...] | None, expected: tuple[int, ...], path: str | os.PathLike) -> None:
    """CheckpointError if the tensor ``key`` of a file has another shape than the network's; None: it is not there."""
    if found != expected:
        has = "is missing" if found is None else f"has shape {found}"
        raise foreign_weights(path, f"{key} {has}, this network expects {expected}")


def _check_ignored(ignored: Iterable[str], keys: Collection[str]) -> None:
    for name in ignored:
        if not any(below(key, (name,)) for key in keys):
            near = difflib.get_close_matches(name, keys, n=3, cutoff=0.5)
            known = f"near ones: {', '.join(near)}" if near else "see docs/weights.md"
            raise ConfigError(f"--ignore_config {name}: weights do not depend on such a key; {known}")
