"""Conversion of torch modules to ONNX models of standard operators, without control flow or local paths."""

import contextlib
import functools
import importlib.util
import logging
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from fingerflow.errors import FingerflowError

OPSET = 18  # ONNX opset: with newer ones, execution providers fall back to the CPU silently
_PACKAGES = ("onnx", "onnxscript", "onnxruntime")
_CONTROL_FLOW = {"Loop", "If", "Scan"}


def standard_model(
    module: nn.Module, tensors: tuple[Tensor, ...], inputs: Sequence[str], outputs: Sequence[str], free: bool = False
) -> Any:
    """Convert a torch module to an `onnx.ModelProto` of standard operators.

    The module takes tensors by position and returns a tuple of tensors.

    Args:
        module: without data-dependent branches.
        tensors: example inputs; sizes are fixed to theirs.
        inputs, outputs: their names.
        free: leave the number of points free: the second size of every input in which it is larger than two.

    Raises:
        FingerflowError: the module needs operators that are not standard, or control flow.
    """
    import onnxscript.optimizer

    keep_operators()
    sizes = tuple({1: torch.export.Dim.DYNAMIC} if each.shape[1:2] > (2,) else None for each in tensors)
    with _quiet():
        program = torch.onnx.export(
            module,
            tensors,
            dynamo=True,
            opset_version=OPSET,
            input_names=list(inputs),
            output_names=list(outputs),
            dynamic_shapes=(sizes,) if free else None,
            optimize=False,
            verbose=False,
        )
    assert program is not None
    # The exporter's own optimisation is off: it also searches for transformer patterns, which takes most of its time.
    for _ in range(2):
        onnxscript.optimizer.fold_constants(program.model)
        onnxscript.optimizer.remove_unused_nodes(program.model)
    model = program.model_proto
    graph = model.graph
    _use_int32_indices(graph)
    # Remove stack traces, which contain paths of this computer.
    for part in (model, graph, *graph.node, *graph.value_info, *graph.input, *graph.output, *graph.initializer):
        part.doc_string = ""
        del part.metadata_props[:]
    foreign = {f"{node.domain}:{node.op_type}" for node in graph.node if node.domain or node.op_type in _CONTROL_FLOW}
    if foreign or model.functions or [opset.version for opset in model.opset_import] != [OPSET]:
        name = type(module).__name__
        raise FingerflowError(f"the graph of {name} is not of standard operators of opset {OPSET}: {sorted(foreign)}")
    return model


def _use_int32_indices(graph: Any) -> None:
    """Let Gather nodes of an ONNX graph take int32 indices, by removing the exporter's cast to int64."""
    import onnx

    kinds = {value.name: value.type.tensor_type.elem_type for value in graph.value_info}
    short = {
        node.output[0]: node.input[0]
        for node in graph.node
        if node.op_type == "Cast" and kinds.get(node.input[0]) == onnx.TensorProto.INT32
        if node.attribute[0].i == onnx.TensorProto.INT64
    }
    for node in graph.node:
        if node.op_type in ("Gather", "GatherElements") and node.input[1] in short:
            node.input[1] = short[node.input[1]]
    used = {name for node in graph.node for name in node.input} | {value.name for value in graph.output}
    for node in [node for node in graph.node if node.output[0] in short and node.output[0] not in used]:
        graph.node.remove(node)


@functools.cache
def keep_operators() -> None:
    """Let torch's exporter read the table of all operators once in a process, in place of once for each graph, which
    takes a sixth of an export.
    """
    with contextlib.suppress(ImportError, AttributeError):  # another version of torch reads it elsewhere
        registry = importlib.import_module("torch.onnx._internal.exporter._registration").ONNXRegistry
        registry.from_torchlib = staticmethod(functools.cache(registry.from_torchlib))


def need_packages() -> None:
    """Raise FingerflowError if a package for exporting or running graphs is not installed."""
    missing = [name for name in _PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        raise FingerflowError(
            f"graphs in ONNX need {', '.join(missing)}, not installed here: pip install {' '.join(missing)}"
        )


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Suppress the log of torch's ONNX exporter, and its warnings about features that are not used."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
