"""Who may write into the folder of a data set: whoever began it, or anyone where nothing lies yet."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from pcdet_avp.datasets.avp.layout import PARTIAL_SUFFIX, clean_leftovers
from pcdet_avp.datasets.avp.made_by import check_made_by, complete
from pcdet_avp.datasets.avp.manifest import MANIFEST_FILE, Manifest, read_manifest, write_manifest
from pcdet_avp.errors import RecordError
from pcdet_avp.folder_lock import LOCK_FILE, sole_user

COMPARED = ("seed", "generator", "scenes", "class_names", "package_version")


@contextmanager
def claimed(root: Path, manifest: Manifest) -> Iterator[None]:
    """While the block lasts, this process alone makes data in ``root``; RecordError where another one does, or where
    another data set lies there. The manifest is written, and what a killed run left behind is removed."""
    if root.exists() and not root.is_dir():
        raise RecordError(f"{root}: expected the folder of a data set, found a file")
    with sole_user(root):
        _claim(root, manifest)
        yield


def _claim(root: Path, manifest: Manifest) -> None:
    if (root / MANIFEST_FILE).exists():
        found = read_manifest(root)
        check_made_by(found, manifest.generator, root)
        held, ours = (
            replace(each, generator={**each.generator, **complete(each.generator)}) for each in (found, manifest)
        )
        for name in COMPARED:
            if getattr(held, name) != getattr(ours, name):
                raise RecordError(
                    f"{root / MANIFEST_FILE}: holds a data set with another {name}; choose another folder or remove it"
                )
    else:
        _refuse_foreign(root)
    write_manifest(root, manifest)
    clean_leftovers(root)


def _refuse_foreign(root: Path) -> None:
    """RecordError if the folder holds something else: no data are written there."""
    ours = (f".{MANIFEST_FILE}{PARTIAL_SUFFIX}", LOCK_FILE)  # all that a run that was killed at once leaves
    held = sorted(entry.name for entry in root.iterdir() if entry.name not in ours)
    if held:
        raise RecordError(
            f"{root / MANIFEST_FILE}: missing, but the folder holds {', '.join(held[:3])}"
            f"{' ...' if len(held) > 3 else ''}: no data are made here. If it is a recording, its {MANIFEST_FILE} is "
            "needed; otherwise name another folder"
        )
