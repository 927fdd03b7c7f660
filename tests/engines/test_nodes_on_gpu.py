"""Test of the nodes of the graphs of a bundle, which a GPU must all compute itself."""

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime as ort
import pytest
from onnx import TensorProto, shape_inference

from fingerflow.engines.bundle import Bundle, load_bundle

Array = np.ndarray[Any, Any]


@pytest.fixture(scope="module")
def bundle(bundle_of_trials: Path) -> Bundle:
    return load_bundle(bundle_of_trials)


# Element types of the operators that ONNX Runtime computes by CUDA at opset 18 (its docs/OperatorKernels.md): of the
# first input, and for `Where` of the second.
FLAGS = {"BOOL"}
FLOATS = {"FLOAT", "DOUBLE", "FLOAT16"}
ORDERED = FLOATS | {"INT32", "INT64"}
NUMBERS = ORDERED | {"INT8", "INT16", "UINT8", "UINT16"}
ON_CUDA = {
    **dict.fromkeys(("Cast", "Concat", "Constant", "Expand", "Gather", "GatherElements"), NUMBERS | FLAGS),
    **dict.fromkeys(("Identity", "Reshape", "ScatterElements", "Slice", "Split", "Squeeze"), NUMBERS | FLAGS),
    **dict.fromkeys(("Transpose", "Unsqueeze"), NUMBERS | FLAGS),
    **dict.fromkeys(("Abs", "Add", "Div", "Mul", "Sign", "Sub"), NUMBERS),
    **dict.fromkeys(("Less", "LessOrEqual", "Greater", "GreaterOrEqual", "Max", "Min", "Mod", "TopK", "Pow"), ORDERED),
    **dict.fromkeys(("CumSum", "ReduceMax", "ReduceSum"), ORDERED),
    **dict.fromkeys(("ArgMax", "ArgMin", "MatMul", "Relu", "Reciprocal", "Sqrt", "Sin", "Cos", "IsNaN"), FLOATS),
    **dict.fromkeys(("Ceil", "Floor", "Round"), FLOATS),
    **dict.fromkeys(("And", "Or", "Not"), FLAGS),
    "Equal": ORDERED | FLAGS,
    "IsInf": FLOATS - {"FLOAT16"},
    "Neg": ORDERED | {"INT8", "INT16"},
    "Pad": FLOATS | FLAGS,
    "ReduceMean": FLOATS | {"INT32"},
    "ReduceMin": ORDERED | {"INT8", "UINT8"},
    "Resize": FLOATS | {"INT32", "UINT8"},
    "Clip": FLOATS | {"INT64", "INT8", "UINT8"},
    "GatherND": FLOATS | {"BOOL", "INT64"},
    "MaxPool": FLOATS | {"INT8", "UINT8"},
    "Where": ORDERED | {"UINT8"},
}


def left_to_the_processor(path: Path, folder: Path) -> set[tuple[str, str]]:
    """Return operator and element type of the nodes that CUDA does not compute, in the graph as ONNX Runtime
    simplifies it before it assigns the nodes to execution providers.
    """
    options = ort.SessionOptions()
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_BASIC
    options.optimized_model_filepath = str(folder / path.name)
    options.log_severity_level = 3
    ort.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    graph = shape_inference.infer_shapes(onnx.load(folder / path.name), data_prop=True).graph
    types = {one.name: one.type.tensor_type.elem_type for one in (*graph.value_info, *graph.input, *graph.output)}
    types |= {one.name: one.data_type for one in graph.initializer}
    left = set()
    for node in graph.node:
        kind = TensorProto.DataType.Name(types[node.input[1 if node.op_type == "Where" else 0]])
        last = any(one.name == "select_last_index" and one.i for one in node.attribute)
        if last or kind not in ON_CUDA.get(node.op_type, ()):
            left.add((node.op_type, kind))
    return left


def test_a_gpu_leaves_no_node_to_the_processor(bundle: Bundle, tmp_path: Path) -> None:
    """CUDA computes every node of every graph, so that each can be captured, and none copies a value to the host."""
    assert not {name: left for name, path in bundle.files.items() if (left := left_to_the_processor(path, tmp_path))}
