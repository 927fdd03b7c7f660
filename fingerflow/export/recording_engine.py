"""Engine of a recording that runs graphs in ONNX Runtime, exported in memory for the shapes of the recording."""

import threading
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
import torch

from fingerflow.engines.engine import Array, EngineSettings, Images
from fingerflow.engines.graph_engine import GraphEngine
from fingerflow.engines.torch import TorchEngine, images_on
from fingerflow.export.standard_model import need_packages, standard_model
from fingerflow.graphs.engine_graphs import Graph, engine_graphs

_EXPORT = threading.Lock()  # torch exports one graph at a time


@lru_cache(maxsize=4)
def recording_engine(settings: EngineSettings, threads: int) -> "RecordingEngine":
    """Return the engine for recordings with these settings; it keeps the graphs that it has exported.

    Raises FingerflowError if a package for export is not installed.
    """
    need_packages()
    return RecordingEngine(settings, threads)


class RecordingEngine(TorchEngine):
    """Engine of exported graphs for recordings: several frames a call, and any number of points.

    `detect` and `fit` are those of torch: each number of points would need a graph of its own, and `fit` is computed in
    float64.

    Args:
        settings: of the engine.
        threads: inside an operator.
    """

    fixed = True
    images = GraphEngine.images

    def __init__(self, settings: EngineSettings, threads: int) -> None:
        super().__init__(settings, torch.device("cpu"))
        graphs = engine_graphs(settings, points=1)
        self._sessions = {name: ExportedGraph(graph, threads) for name, graph in graphs.items()}
        self.name, self.described = "onnx", "onnx (CPUExecutionProvider)"

    def detect(self, image: Images, mask: Array, count: int) -> Array:
        return super().detect(images_on(torch.device("cpu"), image[:, 0]), mask, count)


class ExportedGraph:
    """Graph with the interface of `engines.sessions.GraphSession`, exported at the first call with new shapes.

    A call of K frames is K runs; inputs of one frame are the same in all of them.
    """

    def __init__(self, graph: Graph, threads: int) -> None:
        self._graph, self._threads = graph, threads
        self._sessions: dict[Any, Any] = {}

    def kept(self, name: str, array: Array) -> Array:
        return array

    def updated(self, name: str, value: Array, array: Array, rows: Array) -> Array:
        return array

    def __call__(self, inputs: Mapping[str, Any]) -> dict[str, Array]:
        arrays = {name: inputs[name] for name in self._graph.inputs}
        for name, array in arrays.items():
            arrays[name] = np.ascontiguousarray(array, np.float32 if array.dtype == np.float64 else None)
        frames = max(map(len, arrays.values()))
        parts = [
            self._run({name: values[k : k + 1] if len(values) == frames else values for name, values in arrays.items()})
            for k in range(frames)
        ]
        return {
            name: np.concatenate(part) for name, part in zip(self._graph.outputs, zip(*parts, strict=True), strict=True)
        }

    def _run(self, arrays: dict[str, Array]) -> list[Array]:
        shapes = tuple((array.shape, array.dtype) for array in arrays.values())
        with _EXPORT:
            if shapes not in self._sessions:
                self._sessions[shapes] = self._exported(arrays)
        session = self._sessions[shapes]
        # The session lacks inputs that the graph does not use.
        return session.run(self._graph.outputs, {feed.name: arrays[feed.name] for feed in session.get_inputs()})

    def _exported(self, arrays: dict[str, Array]) -> Any:
        import onnxruntime

        with torch.inference_mode(False):
            # Copies: the exporter would merge two inputs that are the same tensor.
            tensors = tuple(torch.from_numpy(array.copy()) for array in arrays.values())
            model = standard_model(self._graph, tensors, self._graph.inputs, self._graph.outputs)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = self._threads
        return onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
