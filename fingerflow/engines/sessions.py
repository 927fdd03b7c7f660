"""Sessions of ONNX Runtime: the graphs of a bundle, opened with an execution provider."""

from __future__ import annotations

import importlib
import importlib.util
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from fingerflow.engines.names import PROVIDERS
from fingerflow.errors import FingerflowError

Array = NDArray[Any]

log = logging.getLogger("fingerflow.engines")

_PLUGINS = {"openvino": "onnxruntime_ep_openvino"}  # providers that come as a package beside onnxruntime
_ON_GPU = ("tensorrt", "cuda")  # whose memory holds what is kept from call to call
_FIRST = "track"  # the graph that takes longest: with it providers are tried, and its threads may spin
_NUMPY = {
    "tensor(float)": np.float32,
    "tensor(double)": np.float64,
    "tensor(uint8)": np.uint8,
    "tensor(uint16)": np.uint16,
    "tensor(int32)": np.int32,
    "tensor(int64)": np.int64,
    "tensor(bool)": np.bool_,
}


class Input(NamedTuple):
    """Shape and type of an input; a batch that is free is 1."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]


class Session:
    """A graph of a bundle. Calls from several threads at once are allowed: each has tensors of its own.

    Attributes:
        inputs: by name.
        outputs: shapes by name.
        shares_memory: whether an array in one piece and what is `kept` of it are one memory: on a processor, where the
            graph does not compute in float64.
    """

    def __init__(self, session: ort.InferenceSession, path: Path, device: str) -> None:
        self._session, self._path, self._device = session, path, device
        self.inputs = {one.name: _input(one, path) for one in session.get_inputs()}
        self.outputs = {one.name: tuple(one.shape) for one in session.get_outputs()}
        self._names = list(self.outputs)
        self.shares_memory = device == "cpu" and all(one.dtype != np.float64 for one in self.inputs.values())

    def __call__(self, given: Mapping[str, Any]) -> dict[str, Array]:
        """Outputs by name, floating point as float32, from arrays or values that are `kept`."""
        feed = {name: self._array(name, given[name]) for name in self.inputs}
        try:
            results = self._session.run(self._names, feed)  # arrays: to wrap them takes longer than a small graph
        except Exception as error:
            raise FingerflowError(
                f"{self._path}: onnxruntime cannot run it here ({_first_line(error)}); choose another provider"
            ) from None
        return {name: _single(one) for name, one in zip(self._names, results, strict=True)}

    def kept(self, name: str, array: Array) -> Any:
        """An input that is given call after call, in the memory of the provider."""
        return ort.OrtValue.ortvalue_from_numpy(self._array(name, array), self._device)

    def _array(self, name: str, array: Any) -> Any:
        """Return an array contiguous and of the dtype of the input; a value that is `kept` is returned unchanged."""
        if not isinstance(array, np.ndarray):
            return array
        shape, dtype = self.inputs[name]
        if array.shape != shape:
            raise ValueError(f"{self._path}: {name} is {array.shape} where the graph takes {shape}")
        return np.ascontiguousarray(array, dtype)


class Sessions:
    """Opens graphs with one execution provider, the first that works or the one that was asked for.

    Args:
        files: of the graphs, by name.
        provider: a key of `names.PROVIDERS`, or None for the first in their order.
        threads: inside an operator, 0 for one a core.
        spin: threads of the graph that takes longest wait for work without sleeping. Latency falls and the cores are
            never idle.

    Attributes:
        provider: a key of `names.PROVIDERS`.

    Raises:
        FingerflowError: the provider is not installed or does not run here, or a file is not what its name says.
    """

    def __init__(
        self, files: Mapping[str, Path], provider: str | None = None, threads: int = 0, spin: bool = True
    ) -> None:
        self._files, self._threads, self._spin = files, threads, spin
        installed = _installed_providers()
        if provider is not None and provider not in installed:
            raise FingerflowError(f"provider {provider!r} is not installed here; there are: {', '.join(installed)}")
        first: Session | None = None
        for self.provider in [provider] if provider else installed:
            try:
                first = self._open(_FIRST)
                break
            except _ProviderFailed as failure:
                if provider or self.provider == "cpu":
                    raise FingerflowError(f"provider {self.provider!r}: {failure}; choose another") from None
                log.warning("provider %s is installed but does not run here (%s)", self.provider, failure)
        assert first is not None
        log.info("execution provider: %s (onnxruntime %s)", PROVIDERS[self.provider], ort.__version__)
        self._sessions = {name: first if name == _FIRST else self._open(name) for name in files}

    def __getitem__(self, name: str) -> Session:
        if name not in self._sessions:
            raise FingerflowError(f"the bundle has no graph {name!r}; export it again with all that a player needs")
        return self._sessions[name]

    def _open(self, name: str) -> Session:
        if name not in self._files:
            raise FingerflowError(f"the bundle has no graph {name!r}; export it again with all that a player needs")
        path = self._files[name]
        session = self._session(name, path)
        properties = session.get_modelmeta().custom_metadata_map
        if properties.get("fingerflow.graph") != name:
            found = properties.get("fingerflow.graph", "no fingerflow metadata")
            raise FingerflowError(f"{path}: holds {found!r} where the graph {name!r} is expected: a foreign model file")
        return Session(session, path, "cuda" if self.provider in _ON_GPU else "cpu")

    def _session(self, name: str, path: Path) -> ort.InferenceSession:
        options = ort.SessionOptions()
        options.intra_op_num_threads = self._threads
        options.log_severity_level = 3
        # Threads of the other graphs would spin beside it.
        options.add_session_config_entry("session.intra_op.allow_spinning", str(int(self._spin and name == _FIRST)))
        chosen: list[Any] = [PROVIDERS[self.provider], PROVIDERS["cpu"]]
        if self.provider == "tensorrt":
            engines = {"trt_engine_cache_enable": True, "trt_engine_cache_path": str(path.parent / "tensorrt")}
            chosen[0] = (PROVIDERS["tensorrt"], engines)
        devices = _plugin_devices(self.provider)
        if devices:
            options.add_provider_for_devices(devices[:1], {})
        try:
            session = ort.InferenceSession(path, options, providers=None if devices else list(dict.fromkeys(chosen)))
        except Exception as error:
            if self.provider != "cpu":
                raise _ProviderFailed(_first_line(error)) from None
            raise FingerflowError(
                f"{path}: onnxruntime cannot load it ({_first_line(error)}); export it again"
            ) from None
        if PROVIDERS[self.provider] not in session.get_providers():
            raise _ProviderFailed("onnxruntime fell back to another one; its libraries are missing")
        return session


class _ProviderFailed(Exception):
    """An execution provider cannot run a graph here."""


def _installed_providers() -> list[str]:
    """Keys of PROVIDERS, in their order."""
    available = ort.get_available_providers()
    if PROVIDERS["cuda"] in available:
        ort.preload_dlls()  # CUDA's libraries where they were installed as Python packages
    return [name for name, full in PROVIDERS.items() if full in available or _plugin_devices(name)]


def _plugin_devices(provider: str) -> list[Any]:
    """Devices of an execution provider that is installed as a plugin package."""
    if provider not in _PLUGINS or importlib.util.find_spec(_PLUGINS[provider]) is None:
        return []
    full = PROVIDERS[provider]
    if not any(device.ep_name == full for device in ort.get_ep_devices()):
        ort.register_execution_provider_library(full, importlib.import_module(_PLUGINS[provider]).get_library_path())
    return [device for device in ort.get_ep_devices() if device.ep_name == full]


def _input(argument: Any, path: Path) -> Input:
    shape = [1 if place == 0 and not isinstance(size, int) else size for place, size in enumerate(argument.shape)]
    if not all(isinstance(size, int) for size in shape) or argument.type not in _NUMPY:
        raise FingerflowError(
            f"{path}: {argument.name} is {argument.type} {argument.shape}; the engine needs fixed sizes: export the "
            "bundle with them"
        )
    return Input(tuple(shape), np.dtype(_NUMPY[argument.type]))


def _single(array: Array) -> Array:
    return array.astype(np.float32) if array.dtype == np.float64 else array


def _first_line(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
