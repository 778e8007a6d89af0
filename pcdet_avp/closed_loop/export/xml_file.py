"""XML trees to files: the same tree gives the same bytes, and a file appears whole or not at all."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from pcdet_avp.files import write_bytes

DATE = "2026-01-01T00:00:00"  # of all files: an episode is the same whenever it is written


def write_xml(file: Path, root: ElementTree.Element) -> Path:
    """Write an indented file in UTF-8; its path."""
    ElementTree.indent(root)
    write_bytes(file, ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")
    return file
