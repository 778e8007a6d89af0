"""Weights into a network: our own and OpenPCDet's."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn

from pcdet_avp.errors import CheckpointError
from pcdet_avp.models.norm import drop_foreign_norms
from pcdet_avp.models.weights.agreement import CARRIED, check_meaning, check_shape
from pcdet_avp.models.weights.openpcdet import is_openpcdet, load_openpcdet


def load_weights(model: nn.Module, content: Mapping[str, Any], path: str | os.PathLike, logger: logging.Logger) -> None:
    """Copy a checkpoint's ``model_state`` into ``model`` and log what was not loaded.

    Weights that mean something else are refused (see ``check_meaning``).
    A tensor of another shape means another configuration: a CheckpointError, but where the network is to be trained
    further (``NetworkMeaning.training``) it is left out, as in OpenPCDet. Norm layers trained as another kind are left
    out, and so are names that only one side has; a file of which nothing is left is a CheckpointError too.
    A detector of OpenPCDet with pillars has names and shapes of its own: see ``load_openpcdet``.
    """
    state = content["model_state"]
    if is_openpcdet(state):
        load_openpcdet(model, state, path, logger)
        return
    check_meaning(model, content, path, logger)
    kept, foreign = drop_foreign_norms(state, model)
    own = {key: value for key, value in model.state_dict().items() if key != CARRIED}
    usable = {key: value for key, value in kept.items() if key in own}
    if not set(usable) - {"global_step"}:
        raise CheckpointError(f"{path}: none of its {len(state)} tensors has a name of this network")
    reshaped = _of_another_shape(model, usable, own, path)
    usable = {key: value for key, value in usable.items() if key not in reshaped}
    model.load_state_dict(usable, strict=False)
    for what, keys in (
        ("of another normalisation, not loaded", foreign),
        ("of another shape, not loaded", reshaped),
        ("unknown to this network, not loaded", [key for key in kept if key not in own]),
        ("missing in the file, left as they are", [key for key in own if key not in kept]),
    ):
        if keys:
            logger.warning("%s: %d tensors are %s: %s", path, len(keys), what, _some(keys))
    logger.info("%s: loaded %d of %d tensors", path, len(usable), len(own))


def _of_another_shape(
    model: nn.Module, state: Mapping[str, Tensor], own: Mapping[str, Tensor], path: str | os.PathLike
) -> list[str]:
    """The tensors that further training has to begin anew; CheckpointError without it, or where no other is left."""
    keys = [key for key in own if key in state and state[key].shape != own[key].shape]
    is_start = getattr(getattr(model, "meaning", None), "training", False)
    if keys and (not is_start or not state.keys() - {"global_step", *keys}):
        check_shape(keys[0], tuple(state[keys[0]].shape), tuple(own[keys[0]].shape), path)
    return keys


def _some(keys: list[str]) -> str:
    return ", ".join(keys[:5]) + (" ..." if len(keys) > 5 else "")
