"""The words with which weights of another meaning are refused, and the package's configuration that they belong to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pcdet_avp import shipped
from pcdet_avp.config import load_config
from pcdet_avp.models.weights.meaning import Difference, differences, meaning_of, some_of

KEYS_NAMED = 8
SECTIONS = {"CLASS_NAMES", "DATA_CONFIG", "MODEL"}


def refusal(found: Sequence[Difference], theirs: Mapping[str, Any]) -> str:
    """The rest of a message about a file whose weights mean something else, ``theirs``: what differs, which
    configuration of the package is theirs, if any, and how to insist."""
    keys = " ".join(one.key for one in found[:KEYS_NAMED]) + (" ..." if len(found) > KEYS_NAMED else "")
    own = configuration_of(theirs)
    hint = f" They belong to {own}." if own else ""
    why = f"its weights would be taken for something else.{hint} To use them all the same"
    return f"{some_of(found)}; {why}: --ignore_config {keys}"


def configuration_of(meaning: Mapping[str, Any]) -> str | None:
    """The package's configuration whose weights have this meaning, such as ``cfgs/avp/cp_small_first.yaml``.

    Of several the one with the shortest name; None where there is none, or where the meaning lacks a section.
    """
    if not {key.partition(".")[0] for key in meaning} >= SECTIONS:
        return None
    files = sorted(shipped.ROOT.glob("cfgs/avp/*.yaml"), key=lambda file: (len(file.stem), file.stem))
    fitting = (file for file in files if not differences(meaning, meaning_of(load_config(file))))
    return next((file.relative_to(shipped.ROOT).as_posix() for file in fitting), None)
