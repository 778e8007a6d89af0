"""Thresholds of POST_PROCESSING, one number for all classes or one per class. Imports no torch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pcdet_avp.errors import ConfigError
from pcdet_avp.structures.frame import CLASS_NAMES


def per_class(value: float | Mapping[str, float], class_names: Sequence[str], key: str) -> list[float]:
    """One number for all classes, or a mapping from class names, as a list in the order of ``class_names``.

    The mapping may also name other classes of ours, which this network does not detect. ConfigError for further names.
    """
    if not isinstance(value, Mapping):
        return [float(value)] * len(class_names)
    if not set(class_names) <= set(value) <= {*class_names, *CLASS_NAMES}:
        raise ConfigError(f"POST_PROCESSING.{key}: expected {', '.join(class_names)}, found {', '.join(value)}")
    return [float(value[name]) for name in class_names]
