"""The files of an exported network: graphs in ONNX and ``manifest.json``, all of them or none."""

from __future__ import annotations

import logging
import os
import shutil
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn
from tqdm import tqdm

import pcdet_avp
from pcdet_avp.deploy.manifest import DIGEST, FORMAT, HALVES, MANIFEST, described_sha256, sha256
from pcdet_avp.deploy.runtime import OnnxRuntime, open_runtime
from pcdet_avp.errors import ExportError, OutputError
from pcdet_avp.files import make_folder, write_bytes, write_json
from pcdet_avp.models.cpu_kernels.dispatch import plain_operations
from pcdet_avp.models.export.describe import describe
from pcdet_avp.models.export.pieces import Piece, pieces
from pcdet_avp.models.export.quantise import FLOAT32, Calibration, quantise_convolutions

OPSET = 20  # 21 brings a GroupNormalization of its own, which onnxruntime computes an eighth slower
LIBRARIES = ("onnx", "onnxscript", "onnxruntime")
LARGEST_ERROR = 1e-3  # of an output's largest value, between a graph in onnxruntime and torch


def export_network(
    model: nn.Module,
    class_names: Sequence[str],
    image_shape: Sequence[int],
    folder: Path,
    facts: Mapping[str, Any],
    calibration: Calibration | None = None,
) -> list[str]:
    """Write both halves of a network to a folder; the names of the files.

    ``facts`` go into the manifest. Every graph is run once in onnxruntime and compared with its module. ExportError
    where that fails, where a library is missing, or where the network has a stage that has no form. With
    ``calibration`` the convolutions are int8 (see ``quantise``).
    """
    _check_libraries()
    _check_free(folder)
    network, image_shape = describe(model.eval(), list(class_names)), tuple(image_shape)
    with _whole(folder) as aside:
        todo, files = [*pieces(model, network, image_shape)], {}
        for piece in tqdm(todo, unit="graph", desc=f"exporting to {folder}"):
            content = graph_of(piece)
            error = compare(piece, content)
            write_bytes(aside / piece.file, content)
            about = {"sha256": sha256(content), "bytes": len(content), "precision": FLOAT32}
            files[piece.file] = {**about, "largest_error": error}
        about = {
            "format": FORMAT,
            "package": f"pcdet_avp {pcdet_avp.__version__}",
            "opset": OPSET,
            "libraries": _versions(),
        }
        content = {**about, **facts, "image_shape": list(image_shape), "network": network.as_json(), "files": files}
        content["meaning"] = dict(model.meaning.values)
        write_json(aside / MANIFEST, {**content, DIGEST: described_sha256(content)})
        if calibration is not None:
            quantise_convolutions(aside, calibration)
    return [*files, MANIFEST]


def graph_of(piece: Piece) -> bytes:
    """The ONNX file of a piece; its weights are inside."""
    axes = {axis: torch.export.Dim(axis) for axis in piece.free.values()}
    shapes = {name: {0: axes[piece.free[name]]} if name in piece.free else None for name in piece.inputs}
    with torch.no_grad(), plain_operations(), _quiet():
        program = torch.onnx.export(
            piece.form.eval(),
            kwargs=dict(piece.inputs),
            dynamic_shapes=shapes,
            output_names=list(piece.outputs),
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
        return program.model_proto.SerializeToString()


def compare(piece: Piece, content: bytes) -> float:
    """Largest difference between a graph in onnxruntime and its form in torch, over the largest value of an output."""
    with torch.no_grad(), plain_operations():
        expected = piece.form(**piece.inputs)
    expected = expected if isinstance(expected, tuple) else (expected,)
    found = OnnxRuntime(1).load(content, piece.file)({name: value.numpy() for name, value in piece.inputs.items()})
    error = max(_difference(found[name], value) for name, value in zip(piece.outputs, expected, strict=True))
    if not error <= LARGEST_ERROR:
        raise ExportError(f"{piece.file}: onnxruntime differs from torch by {error:.2g} of the largest value")
    return error


def _difference(found: np.ndarray, expected: torch.Tensor) -> float:
    expected = expected.double().numpy()
    return float(np.abs(found - expected).max() / max(np.abs(expected).max(), 1e-6))


@contextmanager
def _whole(folder: Path) -> Iterator[Path]:
    """A new folder beside ``folder``, which takes its place when the block ends and vanishes where it raises."""
    folder = Path(os.path.abspath(folder))  # "." has no name
    aside = folder.with_name(f"{folder.name}.partial")
    shutil.rmtree(aside, ignore_errors=True)
    try:
        make_folder(aside)
        yield aside
        with suppress(FileNotFoundError):
            shutil.rmtree(folder)
        os.replace(aside, folder)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written ({error.strerror or error})") from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _check_free(folder: Path) -> None:
    """OutputError where the folder holds anything but an earlier export, which is replaced."""
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"--out {folder}: expected a folder, found a file")
    held = (path.relative_to(folder) for path in folder.rglob("*") if not path.is_dir() or path.is_symlink())
    foreign = next((file for file in held if not (_is_graph(file) or file == Path(MANIFEST))), None)
    if foreign is None and (folder / MANIFEST).exists() and not any(folder.glob("*/*.onnx")):
        foreign = MANIFEST  # its name is nothing special
    if foreign:
        raise OutputError(
            f"--out {folder}: holds {foreign}, which is no part of an exported network; give another folder"
        )


def _is_graph(file: Path) -> bool:
    return str(file.parent) in HALVES and file.suffix == ".onnx"


def _check_libraries() -> None:
    missing = [name for name in LIBRARIES if name not in _versions()]
    if missing:
        raise ExportError(f"exporting needs {', '.join(missing)}: pip install 'pcdet_avp[export]'")
    open_runtime("onnxruntime")


def _versions() -> dict[str, str]:
    found = {"torch": torch.__version__}
    for name in LIBRARIES:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


@contextmanager
def _quiet() -> Iterator[None]:
    """Without the exporter's remarks about its own insides and about torchvision, which nobody here uses.

    ``torch.__trace`` describes every tensor to whoever listens to all logs (pytest does), which takes minutes.
    """
    logs = [logging.getLogger(name) for name in ("torch.onnx", "torch.__trace")]
    levels = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for log, level in zip(logs, levels, strict=True):
            log.setLevel(level)
