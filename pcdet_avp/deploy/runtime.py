"""Who computes a graph: onnxruntime or OpenVINO behind one small interface. Both compute in float32.

OpenVINO's own choice on CPUs with bf16 instructions is bf16 for everything, the coordinates of points included, which
moves the LiDAR map by more than its own size in places; so it is told float32, and what it made of that is checked.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from pcdet_avp.errors import ExportError

Arrays = dict[str, np.ndarray]
Graph = Callable[[Arrays], Arrays]  # inputs by name -> outputs by name
TORCH = "torch"  # by name the runtime that is none of these
PRECISIONS = ("auto", "float32", "bf16")  # of torch; see ``models.precision``
PRECISION_HINT = "INFERENCE_PRECISION_HINT"


class Runtime(Protocol):
    """Makes graphs of ONNX files' contents."""

    name: str
    version: str

    def load(self, content: bytes, what: str) -> Graph:
        """The graph of an ONNX file; ``what`` names it in an ExportError where it cannot be loaded."""
        ...


class OnnxRuntime:
    """onnxruntime on the CPU, with this many threads inside an operator."""

    name = "onnxruntime"

    def __init__(self, threads: int) -> None:
        self._library, self._threads = _library("onnxruntime"), threads
        self.version = self._library.__version__

    def load(self, content: bytes, what: str) -> Graph:
        options = self._library.SessionOptions()
        options.intra_op_num_threads, options.inter_op_num_threads = self._threads, 1
        options.enable_cpu_mem_arena = False  # every session would keep one of its own: twice the memory, no less time
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # cores belong to others as well
        try:
            session = self._library.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # the library has a dozen classes of its own without a common base
            raise ExportError(f"{what}: onnxruntime cannot load it ({_first_line(error)})") from error
        names = [output.name for output in session.get_outputs()]
        return lambda inputs: dict(zip(names, session.run(names, inputs), strict=True))


class OpenVino:
    """OpenVINO on the CPU, with this many threads, in float32 whatever the CPU prefers."""

    name = "openvino"

    def __init__(self, threads: int) -> None:
        library = _library("openvino")
        self._core, self.version = library.Core(), library.__version__.partition("-")[0]
        self._options = {
            PRECISION_HINT: "f32",
            "INFERENCE_NUM_THREADS": threads,
            "PERFORMANCE_HINT": "LATENCY",
            "NUM_STREAMS": 1,
        }

    def load(self, content: bytes, what: str) -> Graph:
        try:
            compiled = self._core.compile_model(self._core.read_model(content), "CPU", self._options)
        except RuntimeError as error:
            raise ExportError(f"{what}: OpenVINO cannot load it ({_first_line(error)})") from error
        used = compiled.get_property(PRECISION_HINT).to_string()
        if used != "f32":
            raise ExportError(f"{what}: OpenVINO: {PRECISION_HINT}: expected f32, found {used}")
        names = {name: i for i, output in enumerate(compiled.outputs) for name in output.get_names()}
        request = compiled.create_infer_request()

        def run(inputs: Arrays) -> Arrays:
            found = request.infer(inputs, share_inputs=True)
            return {name: found[i].copy() for name, i in names.items()}  # the request writes over its own next time

        return run


RUNTIMES: dict[str, Callable[[int], Runtime]] = {"onnxruntime": OnnxRuntime, "openvino": OpenVino}


def open_runtime(name: str, threads: int | None = None) -> Runtime:
    """The runtime of a name, by default with as many threads as OMP_NUM_THREADS or the machine allows.

    ExportError where it is unknown or not installed.
    """
    if name not in RUNTIMES:
        raise ExportError(f"runtime {name!r}: expected one of {', '.join(RUNTIMES)}")
    return RUNTIMES[name](threads or allowed_threads())


def allowed_threads() -> int:
    """What torch takes, too: OMP_NUM_THREADS, else one for each core that this process may use."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return int(asked) if asked.isdecimal() and int(asked) else len(os.sched_getaffinity(0))


def _library(name: str) -> Any:
    try:
        return __import__(name)
    except ImportError as error:
        raise ExportError(f"--runtime {name}: not installed ({error}); pip install {name}") from error


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:160]
