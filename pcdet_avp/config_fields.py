"""Sections of a configuration as fields of a dataclass: keys are the fields' names in capitals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from pcdet_avp.errors import ConfigError


def fields_from(settings: type, section: Mapping[str, Any], where: str, leave_out: tuple[str, ...] = ()) -> dict:
    """Field name -> value of a section; the names in lower case are read too. ``leave_out``: fields set elsewhere.

    Raises ConfigError where there is no section, for a key that is no field, and for a field that is given twice.
    """
    if not isinstance(section, Mapping):
        raise ConfigError(f"{where}: expected a section of keys, found {section!r}")
    known = [field.name for field in fields(settings) if field.name not in leave_out]
    found = {}
    for key, value in section.items():
        name = str(key).lower()
        if name not in known or key not in (name, name.upper()):
            raise ConfigError(f"{where}: unknown key {key!r}; known: {', '.join(known).upper()}")
        if name in found:
            raise ConfigError(f"{where}: {name.upper()} is given twice, in capitals and in lower case")
        found[name] = value
    return found
