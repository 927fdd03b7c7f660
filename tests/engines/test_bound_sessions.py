"""Tests of graphs of a bundle whose inputs and outputs are at fixed addresses, as on a GPU but in the processor's
memory, and of the nodes of the graphs, which a GPU must all compute itself.
"""

import logging
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime as ort
import pytest
from onnx import TensorProto, shape_inference

from fingerflow.engines import choice, sessions
from fingerflow.engines.bundle import Bundle, load_bundle
from fingerflow.engines.check import check_engine
from fingerflow.engines.sessions import GraphSession
from fingerflow.errors import FingerflowError
from fingerflow.schema.recipe import GRAPHS, GraphName

Array = np.ndarray[Any, Any]


@pytest.fixture(scope="module")
def bundle(bundle_of_trials: Path) -> Bundle:
    return load_bundle(bundle_of_trials)


def opened(bundle: Bundle, name: GraphName, bound: bool) -> GraphSession:
    path = bundle.files[name]
    return GraphSession(ort.InferenceSession(path, providers=["CPUExecutionProvider"]), path, "cpu", bound)


def inputs(session: GraphSession, seed: int) -> dict[str, Array]:
    """Return random grey levels, indices or flags for all inputs of a graph, by name."""
    random = np.random.default_rng(seed)
    given: dict[str, Array] = {}
    for name, (shape, dtype) in session.inputs.items():
        if dtype.kind == "f":
            given[name] = (20 + 40 * random.random(shape)).astype(dtype)
        else:
            given[name] = random.integers(0, 2 if dtype.kind == "b" else 20, shape).astype(dtype)
    return given


@pytest.mark.parametrize("name", ["contact", "detect", "track_few", "fields_entered"])
def test_results_of_a_graph(bundle: Bundle, name: GraphName) -> None:
    """A bound session gives the results of an unbound session for each input; the next call does not change earlier
    results, and no address changes.
    """
    plain, bound = (opened(bundle, name, way) for way in (False, True))
    assert bound._bound is not None
    values = {**bound._bound._given, **bound._bound._found}
    addresses = {key: value.data_ptr() for key, value in values.items()}
    assert not bound.shares_memory
    before: list[dict[str, Array]] = []
    for seed in (0, 1):
        given = inputs(plain, seed)
        found, expected = bound(given), plain(given)
        for key, array in expected.items():
            np.testing.assert_array_equal(found[key], array, err_msg=key)
            assert values[key].shape() == list(array.shape)
        before.append({key: array.copy() for key, array in found.items()})
        if seed == 0:
            first = found
    assert {key: value.data_ptr() for key, value in values.items()} == addresses
    assert all(np.array_equal(first[key], array, equal_nan=True) for key, array in before[0].items())


def test_kept_values_are_copied_when_they_change(bundle: Bundle) -> None:
    plain, bound = (opened(bundle, "noise", way) for way in (False, True))
    frames = [inputs(plain, seed)["topography_view"] for seed in (0, 1)]
    kept = [bound.kept("topography_view", frame) for frame in frames]
    for number in (0, 0, 1, 0):
        found = bound({"topography_view": kept[number]})["noise"]
        assert found == plain({"topography_view": frames[number]})["noise"]


@pytest.fixture
def all_bound(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Bind the sessions of the processor as those of a GPU; return a list that gets, for each session, whether it was
    to be captured. Capturing fails for the graphs `contact` and `threshold`.
    """
    asked: list[bool] = []
    open_session = sessions._open_session

    def session(path: Path, *given: Any, captured: bool = False) -> Any:
        asked.append(captured)
        if captured and path.stem in ("contact", "threshold"):
            raise FingerflowError("nodes have been left to the processor")
        return open_session(path, *given)

    monkeypatch.setattr(sessions, "_open_session", session)
    monkeypatch.setattr(sessions, "GraphSession", lambda of, path, _device, bound: GraphSession(of, path, "cpu", True))
    monkeypatch.setitem(sessions.CAPTURING, "cpu", "captured")
    return asked


def test_an_engine_of_bound_sessions(bundle: Bundle, all_bound: list[bool], caplog: pytest.LogCaptureFixture) -> None:
    """An engine of bound sessions gives the numbers of the bundle; a graph that cannot be captured is named in a
    warning and opened without capture.
    """
    with caplog.at_level(logging.WARNING):
        engine = choice.open_onnx(bundle, captured=True)
    assert engine.described == "onnx (CPUExecutionProvider, captured)"
    assert Counter(all_bound) == {True: len(GRAPHS), False: 2}
    assert [message.split(":")[0] for message in caplog.messages] == [
        f"{name}.onnx is not captured as a graph" for name in GRAPHS if name in ("contact", "threshold")
    ]
    check_engine(engine, bundle.expected)


def test_a_provider_that_captures_wrongly_is_taken_without(
    bundle: Bundle, all_bound: list[bool], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A provider whose captured graphs always return their first results is used without capture."""
    right = sessions._BoundSession.__call__
    first: dict[int, list[Array]] = {}

    def for_ever(self: Any, feed: Any) -> list[Array]:
        return first.setdefault(id(self), right(self, feed)) if all_bound[-1] else right(self, feed)

    monkeypatch.setattr(sessions._BoundSession, "__call__", for_ever)
    with caplog.at_level(logging.WARNING):
        engine = choice.engine_of_stream(bundle, "onnx", "cpu")
    assert engine.described == "onnx (CPUExecutionProvider)"
    assert "provider cpu does not serve here with captured graphs" in caplog.text
    assert "are not the expected ones" in caplog.text


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
