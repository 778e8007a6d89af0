"""A command of the tour, and what the page shows of its results."""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pcdet_avp.cli import COMMANDS, program
from pcdet_avp.errors import ConfigError
from pcdet_avp.visualization.page import Section, Table
from pcdet_avp.visualization.page.parts import Part


@dataclass(frozen=True)
class Step:
    """command: a module of ``pcdet_avp.commands`` and its arguments. parts: reads what it left; called once it has
    succeeded."""

    title: str
    text: str
    command: Sequence[str]
    parts: Callable[[], Sequence[Part]] = tuple

    @property
    def command_line(self) -> str:
        """The command as a user would type it: a script of the checkout, or of the installed package."""
        module, *arguments = self.command
        return shlex.join([*program(module), *arguments])

    def run(self) -> None:
        """ConfigError if the command fails; its own message stands above."""
        print(f"\n{self.title}\n  {self.command_line}", flush=True)
        module, *arguments = self.command
        done = subprocess.run([sys.executable, "-m", f"{COMMANDS}.{module}", *arguments], check=False)
        if done.returncode:
            raise ConfigError(f"the tour ended at: {self.command_line} (exit status {done.returncode})")

    def section(self) -> Section:
        """The step's part of the page. ConfigError where a result is missing."""
        parts = self.parts()
        told = any(isinstance(part, Table) and part.source for part in parts)  # a table's caption names the command
        return Section(self.title, self.text, "" if told else self.command_line, parts)
