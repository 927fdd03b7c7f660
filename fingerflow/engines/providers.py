"""Execution providers of ONNX Runtime on this computer: built-in providers and those of plugin packages."""

from __future__ import annotations

import importlib
import logging
import pkgutil
from typing import Any

import onnxruntime as ort

from fingerflow.errors import FingerflowError

log = logging.getLogger("fingerflow.engines")

#: Short name of the CPU provider, which is always installed.
CPU = "cpu"
_SUFFIX = "ExecutionProvider"
_PLUGINS = "onnxruntime_ep_"  # prefix of the names of plugin packages
_REMOTE = "AzureExecutionProvider"  # runs models on a remote server, not on this computer


def installed_providers() -> dict[str, str]:
    """Return the execution providers of this computer by short name, such as "cuda" for "CUDAExecutionProvider".

    They are in the order in which to try them: built-in ones as ONNX Runtime orders them, plugin packages, the CPU.
    """
    built_in = [name for name in ort.get_available_providers() if name != _REMOTE]
    if any(name.startswith("CUDA") for name in built_in):
        ort.preload_dlls()  # loads CUDA's libraries if they were installed as Python packages
    _register_plugins()
    plugged = [device.ep_name for device in ort.get_ep_devices() if device.ep_name not in built_in]
    names = {full.removesuffix(_SUFFIX).lower(): full for full in (*built_in, *plugged)}
    return {**{name: full for name, full in names.items() if name != CPU}, CPU: names[CPU]}


def provider_named(name: str) -> str:
    """Return the full name of an installed execution provider, given the short name.

    Raises:
        FingerflowError: it is not installed.
    """
    installed = installed_providers()
    if name not in installed:
        raise FingerflowError(f"provider {name!r} is not installed here; there are: {', '.join(installed)}")
    return installed[name]


def plugin_devices(full: str) -> list[Any]:
    """Return the devices of an execution provider from a plugin package; an empty list for a built-in provider."""
    if full in ort.get_available_providers():
        return []
    return [device for device in ort.get_ep_devices() if device.ep_name == full]


def _register_plugins() -> None:
    """Register the execution provider of each installed plugin package with ONNX Runtime, once."""
    for module in pkgutil.iter_modules():
        if module.name.startswith(_PLUGINS) and module.name not in _registered:
            _registered.add(module.name)
            try:
                library = importlib.import_module(module.name).get_library_path()
                ort.register_execution_provider_library(module.name, library)
            except Exception as error:  # a plugin package may raise anything; the other providers remain usable
                log.warning("the package %s is installed but its provider cannot be loaded (%s)", module.name, error)


_registered: set[str] = set()
