"""The graphs of a bundle by torch and the compiled kernels, behind what the player uses of ONNX Runtime's sessions.

What is computed is the module that was exported, every op of it by its compiled twin: the same numbers, to rounding.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import onnxruntime
import torch
from pydantic import ValidationError

from fingerflow import kernels
from fingerflow.errors import FingerflowError
from fingerflow.export.build import Graph, build
from fingerflow.export.bundle import version
from fingerflow.export.recipe import GraphName, Recipe
from fingerflow.graphs.frame import COMPILED_DO_WITHOUT

Array = np.ndarray[Any, Any]


class CompiledGraphs:
    """Opens the graphs that a bundle was exported from.

    Args:
        recipe: of the bundle, as bundle.json has it.
        made_by: the version of fingerflow that wrote the bundle.
        threads: of torch and the kernels, 0 for as many as there are.

    Raises:
        FingerflowError: this installation has no compiled kernels, is of another version, or the recipe computes in
            float64.
    """

    def __init__(self, recipe: Mapping[str, Any], made_by: str, threads: int = 0) -> None:
        if made_by != version():
            raise FingerflowError(
                f"the bundle was written by fingerflow {made_by}, {version()} is installed: export the bundle again"
            )
        try:
            settings = Recipe.model_validate(dict(recipe))
        except ValidationError as error:
            raise FingerflowError(
                f"the recipe of bundle.json is not valid ({error}): export the bundle again"
            ) from None
        if settings.export.precision != "float32":
            raise FingerflowError(f"the bundle computes in {settings.export.precision}, compiled kernels in float32")
        if not kernels.serve():
            raise FingerflowError(
                "fingerflow was installed without its compiled kernels, or FINGERFLOW_KERNELS=0 turns them off; "
                "install it where a C++ compiler is"
            )
        if threads:
            torch.set_num_threads(threads)
        self._graphs = build(settings, without=COMPILED_DO_WITHOUT)

    def open(self, name: str, path: Path) -> "CompiledSession":
        """A graph by name, and the file that it was exported to."""
        return CompiledSession(self._graphs[cast(GraphName, name)], path)


class CompiledSession:
    """A graph with the methods of `onnxruntime.InferenceSession` that the player calls.

    Inputs and outputs are those of the file, but for what compiled kernels do without.
    """

    def __init__(self, graph: Graph, path: Path) -> None:
        options = onnxruntime.SessionOptions()
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL  # it is read, not run
        exported = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        self._graph = graph
        self._inputs = [one for one in exported.get_inputs() if one.name in graph.inputs]
        self._outputs = [one for one in exported.get_outputs() if one.name in graph.outputs]
        self._about = exported.get_modelmeta()

    def get_inputs(self) -> list[Any]:
        """Name, shape and type each."""
        return self._inputs

    def get_outputs(self) -> list[Any]:
        """Name, shape and type each."""
        return self._outputs

    def get_modelmeta(self) -> Any:
        """Of the file."""
        return self._about

    def run(self, names: Sequence[str], feed: Mapping[str, Array]) -> list[Array]:
        """Outputs by name."""
        results = self._results(feed)
        return [results[name] for name in names]

    def io_binding(self) -> "Binding":
        """Inputs and outputs to be bound."""
        return Binding()

    def run_with_iobinding(self, binding: "Binding") -> None:
        """Writes the outputs that are bound, from the inputs."""
        results = self._results({name: value.numpy() for name, value in binding.inputs.items()})
        for name, value in binding.outputs.items():
            value.update_inplace(results[name])

    def _results(self, feed: Mapping[str, Array]) -> dict[str, Array]:
        with torch.inference_mode():
            # An input that an exported graph does not use is none of the file's; a module takes it all the same.
            tensors = [torch.from_numpy(feed[name]) if name in feed else _UNUSED for name in self._graph.inputs]
            results = self._graph.module(*tensors)
        return {name: one.contiguous().numpy() for name, one in zip(self._graph.outputs, results, strict=True)}


_UNUSED = torch.zeros(1)


class Binding:
    """`onnxruntime.OrtValue` by name."""

    def __init__(self) -> None:
        self.inputs: dict[str, Any] = {}
        self.outputs: dict[str, Any] = {}

    def bind_ortvalue_input(self, name: str, value: Any) -> None:
        """In place of the one before."""
        self.inputs[name] = value

    def bind_ortvalue_output(self, name: str, value: Any) -> None:
        """In place of the one before."""
        self.outputs[name] = value
