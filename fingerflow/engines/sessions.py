"""ONNX Runtime sessions of the graphs of a deployment bundle, opened with one execution provider."""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from fingerflow.engines.providers import CPU, plugin_devices, provider_named
from fingerflow.errors import FingerflowError, first_line

Array = NDArray[Any]

_ON_GPU = ("tensorrt", "cuda")  # providers that keep inputs and outputs in GPU memory
_NUMPY = {
    "tensor(float)": np.float32,
    "tensor(uint8)": np.uint8,
    "tensor(uint16)": np.uint16,
    "tensor(int32)": np.int32,
    "tensor(int64)": np.int64,
    "tensor(bool)": np.bool_,
}


log = logging.getLogger("fingerflow.engines")


class Input(NamedTuple):
    """Shape and dtype of an input or output of an ONNX graph."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]


class GraphSession:
    """ONNX Runtime session of one graph of a bundle, which several threads may call at once.

    Args:
        device: in whose memory inputs are kept, "cpu" or "cuda".
        bound: bind inputs and outputs to fixed addresses of the device.

    Attributes:
        inputs: by name.
        shares_memory: True if a contiguous array and the value that `kept` returns for it share memory: on the CPU.
    """

    def __init__(self, session: ort.InferenceSession, path: Path, device: str, bound: bool) -> None:
        self._session, self._path, self._device = session, path, device
        self.inputs = {one.name: _fixed_size(one, path) for one in session.get_inputs()}
        outputs = {one.name: _fixed_size(one, path) for one in session.get_outputs()}
        self._names = list(outputs)
        self._bound = _BoundSession(session, self.inputs, outputs, device) if bound else None
        self.shares_memory = not bound and device == "cpu"

    def __call__(self, given: Mapping[str, Any]) -> dict[str, Array]:
        """Run the graph on inputs by name and return outputs by name.

        An input is an array or a value that `kept` returned.
        """
        feed = {name: self._array(name, given[name]) for name in self.inputs}
        try:
            # Pass plain arrays if inputs are not bound: binding takes longer than running a small graph.
            results = self._bound(feed) if self._bound else self._session.run(self._names, feed)
        except Exception as error:
            raise FingerflowError(
                f"{self._path}: onnxruntime cannot run it here ({first_line(error)}); choose another provider"
            ) from None
        return dict(zip(self._names, results, strict=True))

    def kept(self, name: str, array: Array) -> Any:
        """Return an input of the graph as a value in the memory of the execution provider (CPU or GPU), which many
        calls can use without another copy.
        """
        return ort.OrtValue.ortvalue_from_numpy(self._array(name, array), self._device)

    def _array(self, name: str, array: Any) -> Any:
        """Return an input as a contiguous array of the graph's dtype; a value from `kept` is returned unchanged."""
        if not isinstance(array, np.ndarray):
            return array
        shape, dtype = self.inputs[name]
        if array.shape != shape or (dtype.kind == "u" and not np.can_cast(array.dtype, dtype, "safe")):
            raise ValueError(f"{self._path}: {name} is {array.dtype} {array.shape}, the graph takes {dtype} {shape}")
        return np.ascontiguousarray(array, dtype)


class _BoundSession:
    """Session whose inputs and outputs have fixed addresses in the memory of a device."""

    def __init__(
        self, session: ort.InferenceSession, inputs: Mapping[str, Input], outputs: Mapping[str, Input], device: str
    ) -> None:
        make = ort.OrtValue.ortvalue_from_shape_and_type
        self._given, self._found = (
            {name: make(one.shape, one.dtype, device) for name, one in some.items()} for some in (inputs, outputs)
        )
        self._session, self._binding = session, session.io_binding()
        for name, value in self._given.items():
            self._binding.bind_ortvalue_input(name, value)
        for name, value in self._found.items():
            self._binding.bind_ortvalue_output(name, value)
        self._latest: dict[str, Any] = {}
        self._lock = threading.Lock()

    def __call__(self, feed: Mapping[str, Any]) -> list[Array]:
        """Run the session on inputs by name and return copies of the outputs; an input made by `GraphSession.kept` is
        copied only if it is new, an array at each call.
        """
        with self._lock:
            for name, value in feed.items():
                if isinstance(value, np.ndarray) or self._latest.get(name) is not value:
                    self._given[name].update_inplace(value)
                    self._latest[name] = value
            self._session.run_with_iobinding(self._binding)
            return [np.array(value.numpy()) for value in self._found.values()]


def open_sessions(files: Mapping[str, Path], provider: str = CPU, threads: int = 1) -> dict[str, GraphSession]:
    """Open the sessions of all graphs of a bundle with one execution provider.

    Args:
        files: paths of the graphs, by name.
        provider: short name, of `providers.installed_providers`.
        threads: inside an operator. One is fastest: an operator of these graphs takes some microseconds, and threads
            wait for each other at each of them.

    Raises:
        FingerflowError: the provider is not installed or does not run here, or a file is not what its name says.
    """
    full, on_gpu = provider_named(provider), provider in _ON_GPU
    sessions = {}
    for name, path in files.items():
        session = _open_session(path, provider, full, threads)
        properties = session.get_modelmeta().custom_metadata_map
        if properties.get("fingerflow.graph") != name:
            found = properties.get("fingerflow.graph", "no fingerflow metadata")
            raise FingerflowError(f"{path}: holds {found!r} where the graph {name!r} is expected: a foreign model file")
        sessions[name] = GraphSession(session, path, "cuda" if on_gpu else CPU, bound=on_gpu)
    return sessions


def _open_session(path: Path, provider: str, full: str, threads: int) -> ort.InferenceSession:
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3
    # Idle threads of other sessions would spin and take processor time from the computing ones.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    if provider == CPU:
        _share_memory()
        options.add_session_config_entry("session.use_env_allocators", "1")
    of_provider: dict[str, Any] = {}
    if provider == "tensorrt":
        of_provider = {"trt_engine_cache_enable": True, "trt_engine_cache_path": str(path.parent / "tensorrt")}
    chosen: list[Any] = [(full, of_provider)]
    if full != provider_named(CPU):
        chosen.append(provider_named(CPU))
    devices = plugin_devices(full)
    if devices:
        options.add_provider_for_devices(devices[:1], {})
    try:
        session = ort.InferenceSession(path, options, providers=None if devices else chosen)
    except Exception as error:
        what = "export it again" if provider == CPU else f"provider {provider!r} fails: choose another"
        raise FingerflowError(f"{path}: onnxruntime cannot load it ({first_line(error)}); {what}") from None
    if full not in session.get_providers():
        raise FingerflowError(
            f"provider {provider!r}: onnxruntime fell back to another one, as its libraries are missing; choose another"
        )
    return session


@cache
def _share_memory() -> None:
    """Let all sessions on the CPU take memory from one pool: a bundle then needs half the memory, at the same speed."""
    kinds = ort.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, ort.OrtMemType.DEFAULT
    ort.create_and_register_allocator(ort.OrtMemoryInfo("Cpu", *kinds), None)


def _fixed_size(argument: Any, path: Path) -> Input:
    if not all(isinstance(size, int) for size in argument.shape) or argument.type not in _NUMPY:
        raise FingerflowError(
            f"{path}: {argument.name} is {argument.type} {argument.shape}; the engine needs fixed sizes: export the "
            "bundle with them"
        )
    return Input(tuple(argument.shape), np.dtype(_NUMPY[argument.type]))
