"""Engine that runs the modules of `graphs` with torch, on any device, also without compiled kernels."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from fingerflow.engines.engine import Array, EngineSettings, Images
from fingerflow.engines.graph_engine import GraphEngine
from fingerflow.graphs import DetectGraph
from fingerflow.graphs.engine_graphs import Graph, engine_graphs
from fingerflow.ops.fields.local_fit import local_gradients
from fingerflow.schema.pixel_types import COMPUTED_TYPES


class TorchSession:
    """Graph that torch runs on a device, with the interface of `engines.sessions.GraphSession`."""

    any_number = True

    def __init__(self, graph: Graph, device: torch.device) -> None:
        self.graph, self._device = graph, device

    def kept(self, name: str, array: Any) -> Any:
        """Return an array as a tensor on the device, float32 if it is floating point; tensors and None unchanged."""
        if not isinstance(array, np.ndarray):
            return array
        tensor = torch.from_numpy(np.ascontiguousarray(array)).to(self._device)
        return tensor.float() if tensor.dtype == torch.float64 else tensor

    def updated(self, name: str, value: Tensor, array: Array, rows: Array) -> Tensor:
        """Update a value of `kept` in the rows (1, L) of `array` (1, N, ...) that have changed, and return it."""
        if not value.is_cpu:  # else it shares memory with the array
            value.index_copy_(1, self.kept("", rows), self.kept(name, array[:, rows]))
        return value

    def __call__(self, inputs: Mapping[str, Any]) -> dict[str, Any]:
        """Run the graph on inputs by name, and return outputs by name as arrays, or None."""
        tensors = self.graph(*(self.kept(name, inputs[name]) for name in self.graph.inputs))
        arrays = (None if tensor is None else as_array(tensor) for tensor in tensors)
        return dict(zip(self.graph.outputs, arrays, strict=True))


class TorchEngine(GraphEngine):
    """Engine that computes with torch on a device; it implements `engine.Engine`.

    Args:
        settings: of the engine.
        device: of the tensors.
    """

    fixed = False

    def __init__(self, settings: EngineSettings, device: torch.device) -> None:
        sessions = {name: TorchSession(graph, device) for name, graph in engine_graphs(settings, points=1).items()}
        super().__init__(sessions, settings, described=f"torch ({device})")
        self._device = device

    def images(self, frames: Array) -> Images:
        return images_on(self._device, frames)

    def detect(self, image: Images, mask: Array, count: int) -> Array:
        graph = DetectGraph(count, self.settings.min_distance_px, self.settings.window_px)
        points = as_array(graph(image, torch.from_numpy(mask).to(self._device)[None, None])[0][0])
        return points[np.isfinite(points).all(-1)]

    def fit(
        self, points: Array, values: Array, queries: Array, gauge: float, variance: Array | None = None
    ) -> tuple[Array, Array | None]:
        def wide(array: Array) -> Tensor:
            return torch.from_numpy(array).to(self._device, torch.float64)

        noise = None if variance is None else wide(variance)
        fit = local_gradients(wide(points[None]), wide(values), wide(queries[None]), gauge_length=gauge, variance=noise)
        return as_array(fit.gradient), None if fit.covariance is None else as_array(fit.covariance)


def as_array(tensor: Tensor) -> Array:
    """Return a tensor as an array; on the CPU they share memory."""
    return tensor.detach().cpu().numpy()


def images_on(device: torch.device, frames: Array) -> Tensor:
    """Return the images (K, H, W) of K frames as a tensor (K, 1, H, W) on a device.

    It must not be written to: on the CPU it shares memory with the frames unless these are converted. uint16 becomes
    int32, with which torch can compute, and float64 becomes float32.
    """
    frames = frames.astype(COMPUTED_TYPES[frames.dtype.name], copy=False)
    if frames.dtype == np.uint16:
        frames = frames.astype(np.int32)
    elif not frames.flags.writeable:
        frames = np.asarray(_DeclaredWritable(frames))
    return torch.from_numpy(frames).to(device)[:, None]


class _DeclaredWritable:
    """Wrapper that declares a read-only array, such as a memory map, writable, so that torch does not warn of it.

    Torch warns of read-only arrays, and engines only read.
    """

    def __init__(self, array: Array) -> None:
        self._array = array  # keeps the array's memory alive as long as the pointer is used
        address = array.__array_interface__["data"][0]
        self.__array_interface__ = {**array.__array_interface__, "data": (address, False)}
