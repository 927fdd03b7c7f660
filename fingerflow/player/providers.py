"""Execution providers: what computes the graphs of a bundle."""

from __future__ import annotations

import importlib
import importlib.util
import logging
from pathlib import Path
from typing import Any

import onnxruntime as ort

from .bundle import Bundle
from .errors import PlayerError, first_line

log = logging.getLogger("fingerflow.player")

_COMPILED = "compiled"  # none of onnxruntime's: the package fingerflow, where it is installed, and only where asked for
PROVIDERS = {
    "tensorrt": "TensorrtExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "directml": "DmlExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
    "cpu": "CPUExecutionProvider",
    _COMPILED: "compiled kernels of fingerflow",
}
_PLUGINS = {"openvino": "onnxruntime_ep_openvino"}  # providers that come as a package beside onnxruntime
_ON_GPU = ("tensorrt", "cuda")  # those whose memory can be bound, so that states and held tensors stay there


class Engine:
    """Opens the graphs of a bundle with one execution provider, the first that works or the one that was asked for.

    Args:
        provider: a key of PROVIDERS, or None for the first in their order.
        threads: inside an operator, 0 for one a core.
        spin: threads of `frame` wait for work without sleeping. Latency falls and the cores are never idle.
    """

    def __init__(self, bundle: Bundle, provider: str | None = None, threads: int = 0, spin: bool = True) -> None:
        self.bundle = bundle
        self.threads = threads
        self.spin = spin
        self._compiled = _compiled_graphs(bundle, threads) if provider == _COMPILED else None
        installed = _installed_providers()
        if provider is not None and provider not in (*installed, _COMPILED):
            raise PlayerError(f"provider {provider!r} is not installed here; there are: {', '.join(installed)}")
        for self.provider in [provider] if provider else installed:
            try:
                self.frame = self.open("frame")
                break
            except _ProviderFailed as failure:
                if provider or self.provider == "cpu":
                    raise PlayerError(f"provider {self.provider!r}: {failure}; choose another") from None
                log.warning("provider %s is installed but does not run here (%s)", self.provider, failure)
        self.device = "cuda" if self.provider in _ON_GPU else "cpu"
        log.info("execution provider: %s (onnxruntime %s)", PROVIDERS[self.provider], ort.__version__)

    def open(self, name: str) -> ort.InferenceSession:
        """A graph of the bundle; raises PlayerError where the file is not what the bundle says."""
        path = self.bundle.files[name]
        session = self._session(name, path) if self._compiled is None else self._compiled.open(name, path)
        properties = session.get_modelmeta().custom_metadata_map
        if properties.get("fingerflow.graph") != name:
            found = properties.get("fingerflow.graph", "no fingerflow metadata")
            raise PlayerError(f"{path}: holds {found!r} where the graph {name!r} is expected: a foreign model file")
        return session

    def _session(self, name: str, path: Path) -> ort.InferenceSession:
        options = ort.SessionOptions()
        options.intra_op_num_threads = self.threads
        options.log_severity_level = 3
        # The graphs that run rarely must not spin beside `frame`.
        spin = self.spin and name == "frame"
        options.add_session_config_entry("session.intra_op.allow_spinning", str(int(spin)))
        chosen: list[Any] = [PROVIDERS[self.provider], PROVIDERS["cpu"]]
        if self.provider == "tensorrt":
            engines = {"trt_engine_cache_enable": True, "trt_engine_cache_path": str(self.bundle.folder / "tensorrt")}
            chosen[0] = (PROVIDERS["tensorrt"], engines)
        devices = _plugin_devices(self.provider)
        if devices:
            options.add_provider_for_devices(devices[:1], {})
        try:
            session = ort.InferenceSession(path, options, providers=None if devices else list(dict.fromkeys(chosen)))
        except Exception as error:
            if self.provider != "cpu":
                raise _ProviderFailed(first_line(error)) from None
            raise PlayerError(f"{path}: onnxruntime cannot load it ({first_line(error)}); export it again") from None
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


def _compiled_graphs(bundle: Bundle, threads: int) -> Any:
    """The graphs of a bundle by the package that exported it, which the player does without otherwise."""
    try:
        from fingerflow.errors import FingerflowError
        from fingerflow.export.compiled import CompiledGraphs
    except ImportError as error:
        raise PlayerError(
            f"provider {_COMPILED!r}: is the package fingerflow-engine, which is not installed here ({error}); install "
            "it, or choose another"
        ) from None
    try:
        return CompiledGraphs(bundle.recipe, bundle.version, threads)
    except FingerflowError as error:
        raise PlayerError(f"provider {_COMPILED!r}: {error}; or choose another") from None


def _plugin_devices(provider: str) -> list[Any]:
    """Devices of an execution provider that is installed as a plugin package."""
    if provider not in _PLUGINS or importlib.util.find_spec(_PLUGINS[provider]) is None:
        return []
    full = PROVIDERS[provider]
    if not any(device.ep_name == full for device in ort.get_ep_devices()):
        ort.register_execution_provider_library(full, importlib.import_module(_PLUGINS[provider]).get_library_path())
    return [device for device in ort.get_ep_devices() if device.ep_name == full]
