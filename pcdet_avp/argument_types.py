"""What a number or a path on the command line may be: each type refuses the rest before anything starts."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from pcdet_avp.errors import ConfigError


class Parser(argparse.ArgumentParser):
    """Tells a wrong argument as the tools tell every error: one line (see ``cli.run_tool``)."""

    def error(self, message: str) -> None:
        raise ConfigError(f"{message}; {self.prog} --help lists the arguments")


def check_together(
    args: argparse.Namespace, needs: Mapping[str, str], excludes: Iterable[tuple[str, str]] = ()
) -> None:
    """ConfigError for an option without the one that it ``needs``, or beside one that would leave it unused.

    Names of options without their hyphens; an option was given if it is neither None nor False.
    """

    def given(name: str) -> bool:
        return getattr(args, name) is not None and getattr(args, name) is not False

    for name, other in needs.items():
        if given(name) and not given(other):
            raise ConfigError(f"--{name}: belongs to --{other}, which was not given")
    for name, other in excludes:
        if given(name) and given(other):
            raise ConfigError(f"--{name} and --{other}: give one of them")


def _whole(least: int) -> Callable[[str], int]:
    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"expected a whole number, found {text!r}") from None
        if value < least:
            raise argparse.ArgumentTypeError(f"expected {least} or more, found {text!r}")
        return value

    return parse


def _number(accepts: Callable[[float], bool], expected: str) -> Callable[[str], float]:
    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"expected {expected}, found {text!r}") from None
        if not (math.isfinite(value) and accepts(value)):
            raise argparse.ArgumentTypeError(f"expected {expected}, found {text!r}")
        return value

    return parse


positive_int = _whole(1)
column_count = _whole(4)  # x, y, z, intensity and more
non_negative_int = _whole(0)
positive_float = _number(lambda value: value > 0, "a number above 0")
non_negative_float = _number(lambda value: value >= 0, "0 or a number above it")
share = _number(lambda value: 0 <= value <= 1, "a share from 0 to 1")


def path(text: str) -> Path:
    """A path in which ``~`` is the home folder of a user, as a shell has it."""
    if not text:
        raise argparse.ArgumentTypeError("expected a path, found nothing")
    try:
        return Path(text).expanduser()
    except RuntimeError as error:
        raise argparse.ArgumentTypeError(f"{text!r}: {error}") from error


def tag(text: str) -> str:
    """The name of a run's folder, which lies where others of its kind do: ``night``, or ``night/second``."""
    parts = Path(text).parts
    if not text.strip() or not parts or ".." in parts or Path(text).is_absolute():
        raise argparse.ArgumentTypeError(f"expected a name, and no way out of the output folder, found {text!r}")
    return text


def path_text(text: str) -> str:
    """The same as ``path``, as text."""
    return str(path(text))
