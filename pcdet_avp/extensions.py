"""Entries that other packages add to our tables of scenarios and perceptions, found by ``module:name``."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import TypeVar

from pcdet_avp.errors import ConfigError

Entry = TypeVar("Entry")


def find_entry(table: Mapping[str, Entry], name: str, what: str) -> Entry:
    """``table[name]``; of ``module:name`` the module is imported first, which is to add the entry.

    ``what`` says what the table holds, for the message. ConfigError for an unknown module or name.
    """
    if not isinstance(name, str):
        raise ConfigError(f"{what}: expected a name, found {name!r}")
    module, _, short = name.rpartition(":")
    if module:
        _import(module, name, what)
    if short not in table:
        raise ConfigError(f"unknown {what} {short!r}; known: {', '.join(table)}")
    return table[short]


def _import(module: str, name: str, what: str) -> None:
    try:
        import_module(module)
    except ModuleNotFoundError as missing:
        raise ConfigError(f"{what} {name!r}: there is no module {missing.name!r} on Python's path") from missing
