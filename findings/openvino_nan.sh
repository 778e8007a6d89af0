#!/bin/bash
# openvino 2026.4.1 and onnxruntime 1.32.0, CPU, float32: NaN in, an ordinary number out.
#
# A value that is not a number is how a network says that something overflowed or that a sensor's driver sent rubbish.
# torch, numpy and ONNX's own reference implementation hand it on: Relu(NaN), Clip(NaN), Max(NaN, 0) and ReduceMax of
# anything with NaN are NaN. On OpenVINO the first activation makes 0 of it, HardSigmoid even 1, and everything behind
# it, scores included, is finite: no check of the outputs can tell. A mask of zeros is "nothing there".
# ReduceMax (a maximum over channels, as spatial attention and fusion take it) loses more than NaN on OpenVINO: of 9,
# NaN, 1, 2 it makes 2. The 9, a number, is gone: the comparison with NaN fails and the count starts again behind it.
# onnxruntime hands NaN on through activations, but not through MaxPool and ReduceMax, and its ReduceMax over the last
# two axes loses numbers, too: of 1, NaN, 2, 9 in each of four rows it makes 2.
# The standard (ONNX, operators Relu, Clip, Max, ReduceMax) says nothing about NaN, OpenVINO's opset neither.
#
# Way out: look for NaN in what goes INTO a graph (numpy.isfinite), and cut graphs where NaN could arise.
#
# Seen (2026-11-29, AVX2), x = NaN, ReduceMax of (9, NaN, 1, 2) over channels, of rows (1, NaN, 2, 9) over both axes:
#     onnx         Relu nan, Clip nan, HardSigmoid nan, over channels nan, over rows nan
#     onnxruntime  Relu nan, Clip nan, HardSigmoid nan, over channels 9.0, over rows 2.0
#     openvino     Relu 0.0, Clip 0.0, HardSigmoid 1.0, over channels 2.0, over rows 9.0
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet openvino==2026.4.1 onnxruntime==1.32.0 onnx==1.23.2 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import sys
import warnings

import numpy as np
import onnxruntime
import openvino
from onnx import TensorProto, helper
from onnx.reference import ReferenceEvaluator

warnings.simplefilter("ignore")  # numpy's, of the reference implementation
NAN = np.float32("nan")
CHANNELS = np.array([9, NAN, 1, 2], np.float32).reshape(1, 4, 1, 1).repeat(4, 2).repeat(4, 3)
ROWS = np.array([1, NAN, 2, 9], np.float32).reshape(1, 1, 1, 4).repeat(4, 1).repeat(4, 2)


def model(operator, shape, extra=(), **attributes):
    """Of one operator that reads x; ``extra``: its constant inputs."""
    names = [f"constant_{k}" for k in range(len(extra))]
    node = helper.make_node(operator, ["x", *names], ["y"], **attributes)
    x, y = (helper.make_tensor_value_info(name, TensorProto.FLOAT, s) for name, s in (("x", shape), ("y", None)))
    constants = [helper.make_tensor(name, *tensor) for name, tensor in zip(names, extra, strict=True)]
    graph = helper.make_graph([node], "one", [x], [y], constants)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)


def reduce_max(axes):
    return model("ReduceMax", [1, 4, 4, 4], [(TensorProto.INT64, [len(axes)], axes)], keepdims=0)


def scalar(value):
    return TensorProto.FLOAT, [], [value]


CASES = {
    "Relu": (model("Relu", [1, 16]), np.full((1, 16), NAN)),
    "Clip": (model("Clip", [1, 16], [scalar(0.0), scalar(6.0)]), np.full((1, 16), NAN)),
    "HardSigmoid": (model("HardSigmoid", [1, 16]), np.full((1, 16), NAN)),
    "over channels": (reduce_max([1]), CHANNELS),
    "over rows": (reduce_max([2, 3]), ROWS),
}


def in_onnx(made, x):
    return ReferenceEvaluator(made).run(None, {"x": x})[0]


def in_onnxruntime(made, x):
    session = onnxruntime.InferenceSession(made.SerializeToString(), providers=["CPUExecutionProvider"])
    return session.run(None, {"x": x})[0]


def in_openvino(made, x):
    core = openvino.Core()
    compiled = core.compile_model(core.read_model(made.SerializeToString()), "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    return compiled({"x": x})[0]


expected = {
    "onnx": [NAN] * 5,
    "onnxruntime": [NAN, NAN, NAN, 9, 2],
    "openvino": [0, 0, 1, 2, 9],
}
as_seen = True
for name, run in (("onnx", in_onnx), ("onnxruntime", in_onnxruntime), ("openvino", in_openvino)):
    found = [np.unique(np.asarray(run(*case))) for case in CASES.values()]  # all elements are alike
    print(f"{name:12}", ", ".join(f"{case} {' or '.join(map(str, f))}" for case, f in zip(CASES, found, strict=True)))
    as_seen &= all(len(f) == 1 for f in found) and np.array_equal(np.concatenate(found), expected[name], equal_nan=True)
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
