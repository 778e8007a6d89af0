"""What a network of today is called in an older checkout of this repository."""

from __future__ import annotations

from pathlib import Path

FORMER = {"cp_small": "cp_small_2", "cp_small_first": "cp_small"}  # before commit 3a64a79


def named_in(checkout: Path, file: str) -> str:
    """The name that a configuration or weights of today, such as ``cfgs/avp/cp_small.yaml``, have in a checkout."""
    path = Path(file)
    if path.is_absolute() or (checkout / "cfgs" / "avp" / "cp_small_first.yaml").exists():
        return file
    return str(path.with_stem(FORMER.get(path.stem, path.stem)))
