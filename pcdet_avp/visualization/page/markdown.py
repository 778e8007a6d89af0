"""Markdown of our tools as HTML: every table has a caption and scrolls by itself, every picture is embedded."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from markdown import Markdown
from markupsafe import Markup

from pcdet_avp.errors import ConfigError
from pcdet_avp.visualization.page.embed import embedded_picture

HEADING = re.compile(r"h([1-6])")
NUMBER = re.compile(r"[<>=+\-\s]*\d")


def inline_html(text: str) -> Markup:
    """A text of one paragraph, without the paragraph's tags."""
    root = _tree(text)
    if len(root) > 1 or (len(root) and root[0].tag != "p"):
        raise ConfigError(f"expected one paragraph of text, found {text[:60]!r}...")
    return _inner(root[0]) if len(root) else Markup("")


def table_html(lines: Sequence[str], caption: str, source: str = "") -> Markup:
    """A markdown table; ``caption`` and ``source`` are markdown of one paragraph."""
    root = _tree("\n".join(lines))
    if [element.tag for element in root] != ["table"]:
        raise ConfigError(f"table {caption!r}: expected one markdown table, found {[e.tag for e in root]}")
    return _text(_scrolling(root[0], _paragraph(caption), _paragraph(source) if source else None))


def report_html(file: Path, level: int) -> Markup:
    """A whole report with its pictures; its first heading is left out, the others start at ``level``.

    The caption of a table is the bold start of the paragraph before it, or else that paragraph or heading.
    """
    try:
        root = _tree(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: cannot be read ({error})") from error
    if len(root) and root[0].tag == "h1":
        root.remove(root[0])
    _shift_headings(root, level)
    caption = _plain(file.stem)
    for index, element in enumerate(list(root)):
        if element.tag == "table":
            root[index] = _scrolling(element, caption)
        elif (found := _caption_of(element)) is not None:
            caption = found
        for image in element.iter("img"):
            _embed(image, file.parent)
    return _inner(root)


def _tree(text: str) -> Element:
    """The elements of a markdown text; markup in it counts as text."""
    converter = Markdown(extensions=["tables", "sane_lists", "fenced_code"], output_format="xhtml")
    converter.preprocessors.deregister("html_block")
    converter.inlinePatterns.deregister("html")
    return ElementTree.fromstring(f"<div>{converter.convert(text)}</div>")


def _paragraph(text: str) -> Element:
    root = _tree(text)
    return root[0] if len(root) else _plain("")


def _plain(text: str) -> Element:
    element = Element("p")
    element.text = text
    return element


def _caption_of(element: Element) -> Element | None:
    """What a table after this element is about."""
    if element.tag == "p" and len(element) and element[0].tag == "strong" and not (element.text or "").strip():
        return _plain("".join(element[0].itertext()))
    if (element.tag == "p" and element.find("img") is None) or HEADING.fullmatch(element.tag):
        return _plain("".join(element.itertext()))
    return None


def _scrolling(table: Element, caption: Element, source: Element | None = None) -> Element:
    """The table with its caption in a box that scrolls sideways, also by keyboard."""
    bold = caption.find("strong")
    name = " ".join("".join((caption if bold is None else bold).itertext()).split())
    box = Element("div", {"class": "scroll", "role": "region", "tabindex": "0", "aria-label": name})
    head = Element("caption")
    held = SubElement(head, "div")
    for element, style in ((caption, "what"), (source, "source")):
        if element is not None:
            element.set("class", style)
            held.append(element)
    table.insert(0, head)
    _head_rows(table)
    box.append(table)
    return box


def _head_rows(table: Element) -> None:
    """Scopes of all heads; the first cell of every row is one, and so are the next ones where columns hold names."""
    for cell in table.iter("th"):
        cell.set("scope", "col")
    rows = [list(row) for row in table.iterfind("tbody/tr")]
    columns = list(zip(*rows, strict=True))
    heads = 1
    while heads < len(columns) and not any(NUMBER.match("".join(cell.itertext())) for cell in columns[heads]):
        heads += 1
    for row in rows:
        for cell in row[:heads]:
            cell.tag = "th"
            cell.set("scope", "row")
    for cell in table.findall("thead/tr/th")[:heads]:
        cell.set("class", "name")


def _shift_headings(root: Element, level: int) -> None:
    """So that the highest heading has ``level``."""
    headings = [element for element in root if HEADING.fullmatch(element.tag)]
    top = min((int(element.tag[1]) for element in headings), default=0)
    for element in headings:
        element.tag = f"h{min(int(element.tag[1]) - top + level, 6)}"


def _embed(image: Element, folder: Path) -> None:
    picture = embedded_picture(folder / image.get("src", ""))
    image.attrib.update(src=picture.uri, width=str(picture.width), height=str(picture.height), loading="lazy")
    image.set("class", "plot")


def _text(element: Element) -> Markup:
    return Markup(ElementTree.tostring(element, encoding="unicode", method="html"))


def _inner(element: Element) -> Markup:
    inside = Markup.escape(element.text or "")
    return inside + Markup("").join(_text(child) for child in element)
