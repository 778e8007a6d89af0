"""Files that come with the package: configurations (``cfgs/``) and small trained weights (``weights/``).

In a checkout they lie beside the package. A wheel carries them inside it, in ``_data``, where ``setup.py`` puts them
when the wheel is built. A relative name means a file in the working folder first, then the one that comes with the
package; what a configuration inside an installed package says about data is meant for the working folder.
"""

from __future__ import annotations

import difflib
import os
from pathlib import Path

from pcdet_avp.errors import CheckpointError, ConfigError

PACKAGE = Path(__file__).parent
INSTALLED = (PACKAGE / "_data").is_dir()  # else this is a checkout, and an editable installation is one, too
ROOT = PACKAGE / "_data" if INSTALLED else PACKAGE.parent
PATTERNS = {".yaml": "cfgs/**/*.yaml", ".pth": "weights/*.pth"}  # what there is, by the suffix of a name


def find_config(path: str | os.PathLike) -> Path:
    """The file that a name means: one in the working folder, else the one that comes with the package.

    ConfigError where neither exists; it names both places and files with names like this.
    """
    if not isinstance(path, str | os.PathLike):
        raise ConfigError(f"configuration: expected the path of a file, found {path!r:.80}")
    found = find(path)
    if found is None:
        raise ConfigError(f"{path}: {not_found(path)}")
    return found


def find_checkpoint(path: str | os.PathLike) -> Path:
    """The file that a name means: one in the working folder, else weights that come with the package.

    CheckpointError where neither exists.
    """
    path = Path(path)
    found = path if path.exists() else find(path)
    if found is None:
        raise CheckpointError(f"{path}: cannot read this checkpoint: {not_found(path)}")
    return found


def find(name: str | os.PathLike, folder: Path | None = None) -> Path | None:
    """The first of ``places`` that exists; None where none does."""
    return next((place for place in places(name, folder) if place.exists()), None)


def places(name: str | os.PathLike, folder: Path | None = None) -> list[Path]:
    """Absolute paths that ``name`` can mean, in the order in which they are tried; one where the name is absolute.

    ``folder`` is what a relative name is relative to, by default the working folder. Behind it come the package's
    file at the same place below the working folder (``cfgs/avp/mine.yaml`` may name ``cp_small.yaml``), and the
    package's file of this very name.
    """
    here = Path(os.path.abspath((folder or Path.cwd()) / name))
    if Path(name).is_absolute():
        return [here]
    wanted = [ROOT / name]
    if here.is_relative_to(Path.cwd()):
        wanted.insert(0, ROOT / here.relative_to(Path.cwd()))
    inside = [place for place in (Path(os.path.abspath(path)) for path in wanted) if place.is_relative_to(ROOT)]
    return list(dict.fromkeys([here, *inside]))


def not_found(name: str | os.PathLike, folder: Path | None = None) -> str:
    """The rest of an error message about ``name``: where it was looked for, and names like it that exist."""
    looked = " or ".join(str(place) for place in places(name, folder) if place != Path(name)) or "of this name"
    close = difflib.get_close_matches(Path(name).as_posix(), _known(Path(name).suffix), n=3, cutoff=0.5)
    return f"there is no file {looked}" + (f"; near ones: {', '.join(close)}" if close else "")


def _known(suffix: str) -> list[str]:
    """Relative names of the files of a kind, in the working folder and of the package."""
    pattern = PATTERNS.get(suffix, PATTERNS[".yaml"])
    return sorted({path.relative_to(top).as_posix() for top in (Path.cwd(), ROOT) for path in top.glob(pattern)})


def weights_of(config: Path) -> Path | None:
    """Trained weights that come with the package for one of its own configurations; None for any other file."""
    weights, ours = ROOT / "weights" / f"{config.stem}.pth", ROOT / "cfgs" / "avp" / config.name
    return weights if weights.exists() and ours.exists() and ours.samefile(config) else None


def home() -> Path:
    """What stands for ``ROOT`` where something is written: nothing ever is inside an installed package."""
    return Path.cwd() if INSTALLED else ROOT


def in_home(path: str | os.PathLike) -> str:
    """``path``; one below ``ROOT`` stands for the same place below ``home``."""
    path = Path(path)
    return str(home() / path.relative_to(ROOT) if path.is_relative_to(ROOT) else path)
