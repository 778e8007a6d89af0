"""A page of results: headings, sentences, tables and pictures in one HTML file that links to what lies beside it."""

from __future__ import annotations

import html
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

VIDEOS = (".mp4", ".webm")
STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:1100px;margin:2em auto;padding:0 1em}"
    "pre{overflow-x:auto;background:#f5f5f5;padding:1em;font-size:13px;line-height:1.35}"
    "img,video{max-width:100%}code{background:#f5f5f5}"
)


@dataclass(frozen=True)
class Section:
    """What a part of the page shows; files that do not exist are left out.

    text: a sentence or two. command: how it was made. tables: text files, shown as they are.
    figures: pictures and videos, in their order. links: further files.
    """

    title: str
    text: str
    command: str = ""
    tables: Sequence[Path] = ()
    figures: Sequence[Path] = ()
    links: Sequence[Path] = ()


def page(title: str, sections: Sequence[Section], folder: Path) -> str:
    """The page as HTML, to be written into ``folder``: paths are relative to it."""
    parts = [f"<title>{html.escape(title)}</title>", f"<style>{STYLE}</style>", f"<h1>{html.escape(title)}</h1>"]
    for section in sections:
        parts += _section(section, folder)
    return "<!doctype html>\n<meta charset='utf-8'>\n" + "\n".join(parts) + "\n"


def _section(section: Section, folder: Path) -> list[str]:
    parts = [f"<h2>{html.escape(section.title)}</h2>", f"<p>{html.escape(section.text)}</p>"]
    if section.command:
        parts.append(f"<p><code>{html.escape(section.command)}</code></p>")
    for table in filter(Path.exists, section.tables):
        parts.append(f"<pre>{html.escape(table.read_text(encoding='utf-8').strip())}</pre>")
    parts += [_figure(figure, folder) for figure in section.figures if figure.exists()]
    links = [_link(file, folder) for file in section.links if file.exists()]
    return [*parts, f"<p>{', '.join(links)}</p>"] if links else parts


def _figure(file: Path, folder: Path) -> str:
    where = html.escape(os.path.relpath(file, folder))
    if file.suffix in VIDEOS:
        return f"<p><video src='{where}' controls></video></p>"
    return f"<p><a href='{where}'><img src='{where}' alt='{html.escape(file.stem)}'></a></p>"


def _link(file: Path, folder: Path) -> str:
    return f"<a href='{html.escape(os.path.relpath(file, folder))}'>{html.escape(file.name)}</a>"
