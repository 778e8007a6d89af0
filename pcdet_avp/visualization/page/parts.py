"""What a page holds, as plain values. Texts are markdown of one paragraph (``**bold**``, ```code```)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar


@dataclass(frozen=True)
class Table:
    """lines: a markdown table. source: configuration, command, seed and commit of its numbers."""

    caption: str
    lines: Sequence[str]
    source: str = ""
    kind: ClassVar[str] = "table"


@dataclass(frozen=True)
class Picture:
    """alt: what is to be seen, for those who do not see it; caption: what it shows.

    narrow: the same for screens as narrow as a phone's. is_plot: lines on a white ground, which dark screens invert.
    """

    file: Path
    alt: str
    caption: str
    narrow: Path | None = None
    is_plot: bool = False
    kind: ClassVar[str] = "picture"


@dataclass(frozen=True)
class Video:
    """poster: the picture shown until it plays. stills: some of its moments, for those whose browser cannot play it."""

    file: Path
    alt: str
    caption: str
    poster: Path | None = None
    stills: Path | None = None
    kind: ClassVar[str] = "video"


@dataclass(frozen=True)
class Report:
    """A markdown file of one of our tools with its pictures, folded away until it is asked for."""

    title: str
    file: Path
    kind: ClassVar[str] = "report"


Part = Table | Picture | Video | Report


@dataclass(frozen=True)
class Section:
    """command: the command line that made it."""

    title: str
    text: str = ""
    command: str = ""
    parts: Sequence[Part] = ()


@dataclass(frozen=True)
class Comparison:
    """A quantity without and with the roadside, for the head of the page."""

    name: str
    without: str
    with_roadside: str
    remark: str = ""


@dataclass(frozen=True)
class Page:
    """lead: the part that is shown before all sections. about: name and value of where the results come from."""

    title: str
    subtitle: str
    summary: str
    comparisons: Sequence[Comparison] = ()
    lead: Sequence[Part] = ()
    sections: Sequence[Section] = ()
    about: Mapping[str, str] = field(default_factory=dict)
