"""What ``endurance.py`` kills: data making, a training and a closed-loop sweep, each as small as its tool allows."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from endurance_kills import REPOSITORY, Work, digest, half_written

from pcdet_avp.closed_loop.sweep.journal import JOURNAL
from pcdet_avp.closed_loop.sweep.results import EPISODES
from pcdet_avp.datasets.avp.layout import FRAME_FILE, SCENES_DIR

CFG = REPOSITORY / "cfgs" / "avp" / "cp_tiny.yaml"
FRAMES, EPOCHS, TRIALS = 12, 4, 3
TIMES = ("elapsed_s",)  # of a checkpoint: what a clock says, not what was learned


def works(data: Path) -> list[Work]:
    """The three works; ``data`` is a finished data set for the training."""
    return [
        Work("data making", _make_data, _frames, _data_set, half_written),
        Work("training", lambda folder: _train(data), _checkpoints, _last_checkpoint, half_written),
        Work("sweep", _sweep, _episodes, _table, _begins_to_write()),
    ]


def _make_data(folder: Path) -> list:
    tool = REPOSITORY / "tools" / "create_data.py"
    return [tool, "--cfg", CFG, "--frames", FRAMES, "--seed", 7, "--workers", 2, "--out", folder / "data"]


def _train(data: Path) -> list:
    often = ["--ckpt_save_time_interval", 0.2, "--max_ckpt_save_num", 0, "--picture_interval", 10**6]
    size = ["--epochs", EPOCHS, "--batch_size", 2, "--workers", 1, "--seed", 3, "--no_eval"]
    tool = REPOSITORY / "tools" / "train.py"
    return [tool, "--cfg", CFG, *size, *often, "--device", "cpu", "--set", "DATA_CONFIG.DATA_PATH", data]


def _sweep(folder: Path) -> list:
    tool = REPOSITORY / "tools" / "safety_eval.py"
    asked = ["--scenario", "pedestrian", "--perception", "oracle", "--speeds", 3, 8, "--trials", TRIALS, "--seed", 5]
    return [tool, *asked, "--workers", 1, "--out", folder / "sweep"]


def _frames(folder: Path) -> dict[str, str]:
    """Frames that are there, every file of theirs."""
    whole = [p.parent for p in sorted((folder / "data" / SCENES_DIR).glob(f"*/[!.]*/{FRAME_FILE}"))]
    return {f"{p.parent.name}/{p.name}": digest(*(f.read_bytes() for f in sorted(p.iterdir()))) for p in whole}


def _data_set(folder: Path) -> dict[str, str]:
    """Every file below the data set's folder; none may be left over."""
    files = sorted(p for p in (folder / "data").rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): digest(p.read_bytes()) for p in files}


def _checkpoints(folder: Path) -> dict[str, str]:
    """Checkpoints of finished epochs; the latest state between two epochs moves on."""
    return {p.name: content_digest(p) for p in sorted(_run(folder).glob("checkpoint_epoch_*.pth"))}


def _last_checkpoint(folder: Path) -> dict[str, str]:
    return {name: content for name, content in _checkpoints(folder).items() if name == f"checkpoint_epoch_{EPOCHS}.pth"}


def _run(folder: Path) -> Path:
    return folder / "output" / "avp" / CFG.stem / "default" / "ckpt"


def content_digest(file: Path) -> str:
    """Of a checkpoint: weights, optimiser, schedule, random states, all but the time it took, to the last bit."""
    from pcdet_avp.models.weights.checkpoint_file import read_checkpoint

    content = {key: value for key, value in read_checkpoint(file).items() if key not in TIMES}
    return digest(*_parts(content))


def _parts(value: Any) -> list[bytes]:
    """A nest of plain values and tensors as bytes, in order."""
    if isinstance(value, dict):
        return [part for key in sorted(value, key=str) for part in (str(key).encode(), *_parts(value[key]))]
    if isinstance(value, list | tuple):
        return [b"[", *(part for each in value for part in _parts(each)), b"]"]
    if hasattr(value, "numpy"):
        return [str(value.dtype).encode(), str(tuple(value.shape)).encode(), value.cpu().numpy().tobytes()]
    return [repr(value).encode()]


def _journal(folder: Path) -> list[bytes]:
    file = folder / "sweep" / JOURNAL
    return file.read_bytes().split(b"\n")[:-1] if file.exists() else []


def _episodes(folder: Path) -> dict[str, str]:
    """Episodes on disk, by what they are about."""
    rows = [json.loads(line)["row"] for line in _journal(folder)]
    return {
        "/".join(str(row[k]) for k in ("perception", "combo", "speed", "trial")): digest(repr(row).encode())
        for row in rows
    }


def _table(folder: Path) -> dict[str, str]:
    """The file of all episodes, and each of them."""
    file = folder / "sweep" / EPISODES
    return {EPISODES: digest(file.read_bytes()) if file.exists() else "missing", **_episodes(folder)}


def _begins_to_write():
    """Whether the journal has grown since it was last looked at."""
    sizes: dict[Path, int] = {}

    def grown(folder: Path) -> bool:
        file = folder / "sweep" / JOURNAL
        size = file.stat().st_size if file.exists() else 0
        before, sizes[folder] = sizes.get(folder, size), size
        return size > before

    return grown
