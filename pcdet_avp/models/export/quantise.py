"""int8 for the convolutions of an exported network: their ranges come from recorded frames.

Weights are symmetric, one scale for each output channel, and use 7 of the 8 bits: CPUs without VNNI add pairs of
products in 16 bits, which 8 would overflow. Activations are unsigned, one scale for each tensor, and what lies beyond
the 99.99th percentile is clipped. All else stays float32: points and LiDAR encoders, where metres are subtracted from
metres, whatever has no convolution, the head, whose box residuals are no place for 256 steps, and the compressors, so
that a map still becomes torch's bytes.
"""

from __future__ import annotations

import contextlib
import io
import logging
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from pcdet_avp.deploy.deployed import BothHalves, Deployed
from pcdet_avp.deploy.manifest import MANIFEST, Exported, sha256
from pcdet_avp.deploy.runtime import Arrays, Graph, OnnxRuntime, Runtime
from pcdet_avp.errors import ExportError
from pcdet_avp.files import write_bytes, write_json

INT8, FLOAT32 = "int8", "float32"
QUANTISED = ("roadside/camera.onnx", "vehicle/camera.onnx", "vehicle/backbone.onnx")
PERCENTILE = 99.99
LARGEST_MEAN_ERROR = (
    0.05  # of an output's spread, between an int8 graph and its float32 one, on the frames that were seen
)


@dataclass(frozen=True)
class Calibration:
    """Recorded frames with all sensors, as ``prepare`` makes them, and where they come from."""

    samples: Sequence[Mapping[str, Any]]
    frame_ids: Sequence[str]
    split: str


class Recorder:
    """A runtime that keeps what its graphs are given, by file."""

    def __init__(self, runtime: Runtime, files: Sequence[str]) -> None:
        self._runtime, self.name, self.version = runtime, runtime.name, runtime.version
        self.inputs: dict[str, list[Arrays]] = {file: [] for file in files}

    def load(self, content: bytes, what: str) -> Graph:
        """The graph; ``what`` ends in its file's name."""
        graph, file = self._runtime.load(content, what), "/".join(Path(what).parts[-2:])

        def run(inputs: Arrays) -> Arrays:
            if file in self.inputs:
                self.inputs[file].append(inputs)
            return graph(inputs)

        return run


def quantise_convolutions(folder: Path, calibration: Calibration) -> None:
    """Replace graphs of an exported network in float32 by int8 ones, and say so in its manifest.

    ExportError where a graph becomes another function (see ``LARGEST_MEAN_ERROR``).
    """
    exported, runtime = Exported.read(folder), OnnxRuntime(1)
    seen = _inputs(exported, runtime, calibration)
    files = {name: {**about, "precision": FLOAT32} for name, about in exported.files.items()}
    for name in tqdm(QUANTISED, unit="graph", desc="int8"):
        before = exported.graph(name)
        after = int8_graph(before, seen[name])
        graphs = [runtime.load(content, f"{folder / name}") for content in (before, after)]
        error = mean_error(*graphs, seen[name])
        if not error <= LARGEST_MEAN_ERROR:
            raise ExportError(f"{name}: int8 differs from float32 by {error:.2g} of an output's spread on average")
        write_bytes(folder / name, after)
        known = {"sha256": sha256(after), "bytes": len(after), "precision": INT8, "mean_error": error}
        files[name] = {**files[name], **known}
    source = {"split": calibration.split, "frames": list(calibration.frame_ids), "percentile": PERCENTILE}
    write_json(folder / MANIFEST, {**exported.facts, "precision": INT8, "calibration": source, "files": files})


def int8_graph(content: bytes, inputs: Sequence[Arrays]) -> bytes:
    """The same graph with its convolutions in int8, as QuantizeLinear and DequantizeLinear around them."""
    import onnx
    from onnxruntime.quantization import CalibrationMethod, QuantFormat, QuantType, quantize_static

    with tempfile.TemporaryDirectory() as folder, _quiet():
        file = Path(folder) / "int8.onnx"
        quantize_static(
            onnx.load_from_string(content),
            file,
            _Reader(inputs),
            quant_format=QuantFormat.QDQ,
            op_types_to_quantize=["Conv"],
            per_channel=True,
            reduce_range=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            calibrate_method=CalibrationMethod.Percentile,
            extra_options={"CalibPercentile": PERCENTILE},
        )
        return file.read_bytes()


def mean_error(expected: Graph, found: Graph, inputs: Sequence[Arrays]) -> float:
    """Mean absolute difference of two graphs' outputs over the expected ones' standard deviation; the worst output."""
    errors: dict[str, list[float]] = {}
    for one in inputs:
        theirs, ours = expected(one), found(one)
        for name, value in theirs.items():
            spread = max(float(value.std()), 1e-6)
            errors.setdefault(name, []).append(float(np.abs(ours[name] - value).mean()) / spread)
    return max(float(np.mean(values)) for values in errors.values())


def _inputs(exported: Exported, runtime: Runtime, calibration: Calibration) -> dict[str, list[Arrays]]:
    recorder = Recorder(runtime, QUANTISED)
    halves = BothHalves(Deployed(exported, recorder))
    for sample in tqdm(calibration.samples, unit="frame", desc="calibration"):
        halves.detect_alone(sample)
    return recorder.inputs


class _Reader:
    """What onnxruntime's calibration asks for its inputs."""

    def __init__(self, inputs: Sequence[Arrays]) -> None:
        self._left = iter(inputs)

    def get_next(self) -> Arrays | None:
        return next(self._left, None)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without onnxruntime's remarks on how it proceeds, some of which it prints."""
    level = logging.getLogger().level
    logging.getLogger().setLevel(logging.ERROR)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        logging.getLogger().setLevel(level)
