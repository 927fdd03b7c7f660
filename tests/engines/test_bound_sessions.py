"""Tests of graphs of a bundle whose inputs and outputs are at fixed addresses, as on a GPU but in the processor's
memory, and of the nodes of the graphs that a GPU leaves to the processor.
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
from fingerflow.engines.bundle import GRAPHS, Bundle, GraphName, load_bundle
from fingerflow.engines.check import check_engine
from fingerflow.engines.onnx import OnnxEngine
from fingerflow.engines.sessions import GraphSession, Sessions
from fingerflow.errors import FingerflowError

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


@pytest.mark.parametrize("name", GRAPHS)
def test_results_of_each_graph(bundle: Bundle, name: GraphName) -> None:
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
    open_session = Sessions._session

    def session(self: Sessions, path: Path, captured: bool = False) -> Any:
        asked.append(captured)
        if captured and path.stem in ("contact", "threshold"):
            raise FingerflowError("nodes have been left to the processor")
        return open_session(self, path)

    monkeypatch.setattr(Sessions, "_session", session)
    monkeypatch.setattr(sessions, "GraphSession", lambda of, path, _device, bound: GraphSession(of, path, "cpu", True))
    monkeypatch.setitem(sessions.CAPTURING, "cpu", "captured")
    return asked


def test_an_engine_of_bound_sessions(bundle: Bundle, all_bound: list[bool], caplog: pytest.LogCaptureFixture) -> None:
    """An engine of bound sessions gives the numbers of the bundle; a graph that cannot be captured is named in a
    warning and opened without capture.
    """
    with caplog.at_level(logging.WARNING):
        engine = OnnxEngine(bundle.files, bundle.engine_settings, "cpu", captured=True)
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
    assert "not its own" in caplog.text


# Types of the first input that ONNX Runtime computes by CUDA at opset 18 (its docs/OperatorKernels.md), for operators
# that do not take every type.
FLOATS = {TensorProto.FLOAT, TensorProto.DOUBLE, TensorProto.FLOAT16}
ORDERED = FLOATS | {TensorProto.INT32, TensorProto.INT64}
ON_CUDA: dict[str, set[int]] = {
    **dict.fromkeys(("Less", "LessOrEqual", "Greater", "GreaterOrEqual", "Max", "Min", "TopK", "Mod"), ORDERED),
    **dict.fromkeys(("CumSum", "ReduceMax", "ReduceSum"), ORDERED),
    **dict.fromkeys(
        ("ArgMax", "ArgMin", "MatMul", "Ceil", "Floor", "Round", "Sqrt", "Reciprocal", "Sin", "Cos"), FLOATS
    ),
    "Equal": ORDERED | {TensorProto.BOOL},
    "Pad": FLOATS | {TensorProto.BOOL},
    "ReduceMean": FLOATS | {TensorProto.INT32},
    "ReduceMin": ORDERED | {TensorProto.UINT8},
    "Clip": FLOATS | {TensorProto.INT64, TensorProto.UINT8},
    "GatherND": FLOATS | {TensorProto.BOOL, TensorProto.INT64},
    "MaxPool": FLOATS | {TensorProto.UINT8},
}
EVERY_TYPE = {
    *("Abs", "Add", "And", "Cast", "Concat", "Constant", "Div", "Expand", "Gather", "GatherElements", "Identity"),
    *("IsInf", "IsNaN", "Mul", "Neg", "Not", "Or", "Pow", "Relu", "Reshape", "Resize", "ScatterElements", "Sign"),
    *("Slice", "Split", "Squeeze", "Sub", "Transpose", "Unsqueeze", "Where"),
}
# Nodes left to the processor: comparisons of counts in uint8, an angle, ties of a search, sizes of a batch. None is in
# a graph that tracks points or computes fields in every frame.
LEFT = {
    "contact": {("Greater", "UINT8"), ("Atan", "FLOAT")},
    "threshold": {("Greater", "UINT8")},
    "search": {("ArgMin", "INT64"), ("Shape", "FLOAT"), ("Shape", "INT64")},
    **{one: {("Shape", "INT64"), ("Shape", "FLOAT"), ("ConstantOfShape", "INT64")} for one in ("prepare", "renew")},
}


@pytest.mark.parametrize("name", GRAPHS)
def test_nodes_that_a_gpu_leaves_to_the_processor(bundle: Bundle, name: GraphName) -> None:
    model = shape_inference.infer_shapes(onnx.load(bundle.files[name]), data_prop=True)
    graph = model.graph
    types = {one.name: one.type.tensor_type.elem_type for one in (*graph.value_info, *graph.input, *graph.output)}
    types |= {one.name: one.data_type for one in graph.initializer}
    left = set()
    for node in graph.node:
        kind = types[node.input[0]] if node.input else 0
        if node.op_type not in EVERY_TYPE and kind not in ON_CUDA.get(node.op_type, set()):
            left.add((node.op_type, TensorProto.DataType.Name(kind)))
    assert left <= LEFT.get(name, set())
    assert bool(left) == (name in LEFT)
    assert not {node.op_type for node in graph.node} & {"If", "Loop", "Scan", "NonZero", "MemcpyFromHost"}
