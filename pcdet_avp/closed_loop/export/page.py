"""An episode as one HTML file that needs no other: the garage from above, detections and speeds, to be scrubbed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from pcdet_avp.closed_loop.export.drive import DrivenCase
from pcdet_avp.closed_loop.export.formats import ExportSettings
from pcdet_avp.closed_loop.export.page_data import page_data
from pcdet_avp.closed_loop.export.record import EpisodeRecord
from pcdet_avp.files import write_text

FOLDER = Path(__file__).with_name("page")


def write(drives: Sequence[DrivenCase], stem: Path, settings: ExportSettings) -> list[Path]:
    """The page of one drive, or of two of the same trial side by side."""
    file = stem.with_name(f"{stem.name}.html")
    write_text(file, episode_page([drive.record for drive in reversed(drives)]))
    return [file]


def episode_page(records: Sequence[EpisodeRecord]) -> str:
    """The HTML text."""
    loader = PackageLoader("pcdet_avp.closed_loop.export", "page")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    data = page_data(records)
    parts = {name: Markup((FOLDER / f"episode.{name}").read_text(encoding="utf-8")) for name in ("css", "js")}
    return environment.get_template("episode.html").render(
        data=data, json=_as_script(data), css=parts["css"], js=parts["js"], two=len(records) > 1
    )


def _as_script(data: dict) -> Markup:
    """JSON that no browser takes for the end of its element."""
    return Markup(json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"))
