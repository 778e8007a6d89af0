"""Every relative link, picture and anchor of the pages exists; README's quickstart does what README says."""

import re
import subprocess
from collections import Counter
from functools import lru_cache
from pathlib import Path
from urllib.parse import unquote

import pytest

ROOT = Path(__file__).parents[1]
LINK = re.compile(r"\]\(\s*<?([^)\s>]+)>?(?:\s+\"[^\"]*\")?\s*\)")
CODE = re.compile(r"^(```|~~~).*?^\1|`[^`\n]*`", re.DOTALL | re.MULTILINE)
HEADING = re.compile(r"^#{1,6}\s+(.*?)\s*#*$", re.MULTILINE)


def pages():
    """Every Markdown page that git would commit; the files on disk where this is no git checkout."""
    command = ["git", "-C", str(ROOT), "ls-files", "--cached", "--others", "--exclude-standard", "*.md"]
    try:
        names = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split("\n")
    except (OSError, subprocess.CalledProcessError):
        names = [
            str(file.relative_to(ROOT))
            for part in ("", "docs/**/", "pcdet_avp/**/")
            for file in ROOT.glob(f"{part}*.md")
        ]
    return sorted({name for name in names if name and (ROOT / name).exists()})


def targets(text):
    return LINK.findall(CODE.sub("", text))


@lru_cache
def anchors(page):
    """Of every heading, as GitHub names them: lower case, punctuation gone, blanks as hyphens, repetitions counted."""
    seen, found = Counter(), set()
    for heading in HEADING.findall(re.sub(r"^(```|~~~).*?^\1", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)):
        text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading)
        slug = re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-")
        found.add(f"{slug}-{seen[slug]}" if seen[slug] else slug)
        seen[slug] += 1
    return found


def broken(page):
    """The links of a page that lead nowhere."""
    for target in targets(page.read_text()):
        if re.match(r"[a-z][a-z0-9+.-]*:", target):
            continue
        path, _, anchor = unquote(target).partition("#")
        file = (page.parent / path).resolve() if path else page
        if not file.exists() or (anchor and file.suffix == ".md" and anchor not in anchors(file)):
            yield target


@pytest.mark.parametrize("name", pages())
def test_relative_links_lead_somewhere(name):
    assert list(broken(ROOT / name)) == []


def test_a_broken_link_is_noticed(tmp_path):
    page = tmp_path / "page.md"
    (tmp_path / "there.md").write_text("# A heading, twice\n# A heading, twice\n```\n# no heading\n```\n")
    page.write_text(
        "[a](there.md) ![b](gone.png) [c](there.md#a-heading-twice-1) [d](there.md#no-heading) [e](#none) "
        "[f](https://example.org/x) `[g](code.md)`\n```\n[h](block.md)\n```\n"
    )
    assert list(broken(page)) == ["gone.png", "there.md#no-heading", "#none"]


def test_the_quickstart_finds_what_the_readme_says(tmp_path, monkeypatch, capsys):
    readme = (ROOT / "README.md").read_text()
    section = re.search(r"^## Quickstart\n(.*?)^## ", readme, re.DOTALL | re.MULTILINE)[1]
    alone, of, both = map(
        int, re.search(r"finds (\d+) of these (\d+), with the\s+roadside unit it finds all (\d+)", section).groups()
    )
    monkeypatch.chdir(tmp_path)  # nothing but the package's own files
    names = {}
    exec(compile(re.search(r"```python\n(.*?)```", section, re.DOTALL)[1], "README.md", "exec"), names)
    lines = capsys.readouterr().out.splitlines()
    counts = Counter(line.partition(":")[0] for line in lines)
    assert counts == {"CL+none": alone, "CL+CL": both}
    labels, grid = names["frame"].labels, names["network"].input.prepare_config.grid
    truth = Counter(labels.names[grid.contains_bev(labels.boxes)])
    assert truth == Counter({"Car": 4, "Pedestrian": 6})
    assert f"{truth['Car']} cars and {truth['Pedestrian']} pedestrians" in section
    assert truth.total() == of == both
    assert not list(tmp_path.iterdir())
