"""ONNX Runtime sessions of the graphs of a deployment bundle, opened with one execution provider."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as ort

from fingerflow.engines.engine import ANY_NUMBER, Array
from fingerflow.errors import FingerflowError, first_line

#: Short name of the CPU provider, which is always installed.
CPU = "cpu"
_SUFFIX = "ExecutionProvider"
_REMOTE = "AzureExecutionProvider"  # runs models on a remote server, not on this computer
_ON_GPU = ("tensorrt", "cuda")  # providers that keep inputs and outputs in GPU memory
_DTYPES = ("float32", "uint8", "uint16", "int32", "int64", "bool")


class GraphSession:
    """ONNX Runtime session of one graph of a bundle, which several threads may call at once.

    Args:
        name: of the graph.
        provider: short name, which decides in whose memory inputs are kept.

    Attributes:
        inputs: shapes and dtypes by name; no shape where it has a free size.
        any_number: whether the number of points may differ from call to call: providers other than the CPU prepare a
            graph again for each.
    """

    def __init__(self, session: ort.InferenceSession, path: Path, name: str, provider: str) -> None:
        self._session, self._path = session, path
        self._device = "cuda" if provider in _ON_GPU else CPU
        self.any_number = provider == CPU
        self.inputs = {value.name: _size(value, path, name) for value in session.get_inputs()}
        self._names = [output.name for output in session.get_outputs()]

    def __call__(self, values: Mapping[str, Any]) -> dict[str, Array]:
        """Run the graph on inputs by name and return outputs by name.

        An input is an array or a value that `kept` returned.
        """
        feed = {name: self._array(name, values[name]) for name in self.inputs}
        try:
            # Plain arrays and no binding to addresses, which takes longer than running a small graph.
            results = self._session.run(self._names, feed)
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

    def updated(self, name: str, value: Any, array: Array, rows: Array) -> Any:
        """Return the value of `kept` for an array that has changed in some rows; on the CPU they share memory."""
        return value if self._device == CPU else self.kept(name, array)

    def _array(self, name: str, array: Any) -> Any:
        """Return an input as a contiguous array of the graph's dtype; a value from `kept` is returned unchanged."""
        if not isinstance(array, np.ndarray):
            return array
        shape, dtype = self.inputs[name]
        if (shape and array.shape != shape) or (dtype.kind == "u" and not np.can_cast(array.dtype, dtype, "safe")):
            raise ValueError(f"{self._path}: {name} is {array.dtype} {array.shape}, the graph takes {dtype} {shape}")
        return np.ascontiguousarray(array, dtype)


def installed_providers() -> dict[str, str]:
    """Return the execution providers of this computer by short name, such as "cuda" for "CUDAExecutionProvider".

    They are in the order in which to try them, that of ONNX Runtime: the CPU is the last.
    """
    names = [name for name in ort.get_available_providers() if name != _REMOTE]
    if any(name.startswith("CUDA") for name in names):
        ort.preload_dlls()  # loads CUDA's libraries if they were installed as Python packages
    return {full.removesuffix(_SUFFIX).lower(): full for full in names}


def provider_named(name: str) -> str:
    """Return the full name of an installed execution provider, given the short name.

    Raises:
        FingerflowError: it is not installed.
    """
    installed = installed_providers()
    if name not in installed:
        raise FingerflowError(f"provider {name!r} is not installed here; there are: {', '.join(installed)}")
    return installed[name]


def open_sessions(files: Mapping[str, Path], provider: str = CPU, threads: int = 1) -> dict[str, GraphSession]:
    """Open the sessions of all graphs of a bundle with one execution provider.

    Args:
        files: paths of the graphs, by name.
        provider: short name, of `installed_providers`.
        threads: inside an operator. One is fastest: an operator of these graphs takes some microseconds, and threads
            wait for each other at each of them.

    Raises:
        FingerflowError: the provider is not installed or does not run here, or a file is not what its name says.
    """
    full = provider_named(provider)
    sessions = {}
    for name, path in files.items():
        session = _open_session(path, provider, full, threads)
        found = session.get_modelmeta().custom_metadata_map.get("fingerflow.graph", "no fingerflow metadata")
        if found != name:
            raise FingerflowError(f"{path}: holds {found!r} where the graph {name!r} is expected: a foreign model file")
        sessions[name] = GraphSession(session, path, name, provider)
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
    cache = {"trt_engine_cache_enable": True, "trt_engine_cache_path": str(path.parent / "tensorrt")}
    chosen = [(full, cache if provider == "tensorrt" else {}), *([] if provider == CPU else [provider_named(CPU)])]
    try:
        session = ort.InferenceSession(path, options, providers=chosen)
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


def _size(value: Any, path: Path, name: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Return the shape and the dtype of an input of the graph `name`; an empty shape, which ONNX Runtime checks, if a
    size of it is free. Raise FingerflowError for another dtype, and for free sizes of other graphs than `ANY_NUMBER`.
    """
    dtype = value.type.removeprefix("tensor(").removesuffix(")").replace("float", "float32")
    fixed = all(isinstance(size, int) for size in value.shape)
    if dtype not in _DTYPES or not (fixed or name in ANY_NUMBER):
        what = f"{path}: {value.name} is {value.type} {value.shape}"
        raise FingerflowError(f"{what}; the engine needs a usual type and fixed sizes: export the bundle again")
    return tuple(value.shape) if fixed else (), np.dtype(dtype)
