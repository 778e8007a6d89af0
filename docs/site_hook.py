"""Hook of mkdocs: pages of the repository that lie outside docs/, and the reference of the Python interface.

A page outside docs/ (``weights/README.md``) appears in the site below ``repository/``. Links between pages are written
for the repository, where they lead to files; here they are turned to where the site has these files. A link to what
the site does not carry (a folder, weights) becomes plain text.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from urllib.parse import unquote

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[1]
OUTSIDE = "repository"
PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "weights/README.md")
CARRIED = ("", ".md", ".py", ".ipynb", ".yaml", ".cff", ".jpg", ".png")  # suffixes of linked files; "" is LICENSE
PACKAGES = ("structures", "sim", "link", "evaluation", "registration", "deploy", "visualization", "datasets", "models")
PACKAGES += ("engine", "bandwidth", "closed_loop", "placement", "openpcdet")
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\[\]]*\])*)\]\(([^)\s]+)\)")
BLOCK = re.compile(r"(^```.*?^```)", re.DOTALL | re.MULTILINE)


def site_uri(path: str) -> str:
    """Where the site has a file of the repository; both are relative paths with slashes."""
    return path.removeprefix("docs/") if path.startswith("docs/") else f"{OUTSIDE}/{path}"


def repository_path(uri: str) -> str:
    """The opposite of ``site_uri``."""
    return uri.removeprefix(f"{OUTSIDE}/") if uri.startswith(f"{OUTSIDE}/") else f"docs/{uri}"


def linked(page: str, target: str) -> tuple[str, str] | None:
    """The repository path and the anchor that a link of a page means; None for an address or a place on the page."""
    path, _, anchor = target.partition("#")
    if not path or re.match(r"[a-z][a-z0-9+.-]*:", target):
        return None
    return posixpath.normpath(posixpath.join(posixpath.dirname(page), unquote(path))), anchor


def is_carried(path: str) -> bool:
    """Whether the site has this file of the repository."""
    return (ROOT / path).is_file() and Path(path).suffix in CARRIED


def outside_files() -> list[str]:
    """The pages outside docs/ that the site carries, and every file outside docs/ that a page links to."""
    readmes = [file.relative_to(ROOT).as_posix() for file in sorted((ROOT / "pcdet_avp").rglob("README.md"))]
    inside = [file.relative_to(ROOT).as_posix() for file in sorted((ROOT / "docs").rglob("*.md"))]
    waiting, found = [*inside, *PAGES, *readmes], []
    while waiting:
        path = waiting.pop(0)
        if not path.startswith("docs/"):
            found.append(path)
        if path.endswith(".md"):
            text = (ROOT / path).read_text(encoding="utf-8")
            means = [target[0] for *_, link in LINK.findall(text) if (target := linked(path, link))]
            waiting += [m for m in means if m not in waiting + found and not m.startswith("docs/") and is_carried(m)]
    return found


def reference_pages() -> dict[str, str]:
    """Site path -> text, one page per package, and one for the modules at the top."""
    pages = {"api/pcdet_avp.md": _reference("pcdet_avp", sorted((ROOT / "pcdet_avp").glob("*.py")))}
    for package in PACKAGES:
        modules = sorted((ROOT / "pcdet_avp" / package).rglob("*.py"))
        pages[f"api/{package}.md"] = _reference(f"pcdet_avp.{package}", modules)
    return pages


def _reference(title: str, modules: list[Path]) -> str:
    names = [".".join(m.relative_to(ROOT).with_suffix("").parts) for m in modules if not m.stem.startswith("_")]
    return f"# {title}\n\n" + "\n\n".join(f"::: {name}" for name in names) + "\n"


def on_config(config):
    """Add the results' pages, the pages outside docs/ and the reference to the navigation."""
    results = sorted(file.relative_to(ROOT / "docs").as_posix() for file in (ROOT / "docs/results").rglob("*.md"))
    config.nav += [
        {"Results": ["results/README.md", *(uri for uri in results if uri != "results/README.md")]},
        {"Reference": list(reference_pages())},
        {"Repository": [site_uri(path) for path in outside_files() if path.endswith(".md")]},
    ]
    return config


def on_files(files, config):
    """Add the files outside docs/ and the pages of the reference."""
    for path in outside_files():
        files.append(File.generated(config, site_uri(path), abs_src_path=str(ROOT / path)))
    for uri, text in reference_pages().items():
        files.append(File.generated(config, uri, content=text))
    return files


def on_page_markdown(markdown, page, config, files):
    """Turn the links of a page from the repository to the site."""
    uri = page.file.src_uri

    def turned(match: re.Match) -> str:
        mark, text, link = match.groups()
        target = linked(repository_path(uri), link)
        if target is None:
            return match[0]
        path, anchor = target
        if not is_carried(path) and (ROOT / path).exists():
            return text
        there = posixpath.relpath(site_uri(path), posixpath.dirname(uri) or ".")
        return f"{mark}[{text}]({there}{'#' + anchor if anchor else ''})"

    if uri.startswith("api/"):
        return markdown
    parts = BLOCK.split(markdown)  # every second one is code, and stays
    return "".join(part if i % 2 else LINK.sub(turned, part) for i, part in enumerate(parts))
