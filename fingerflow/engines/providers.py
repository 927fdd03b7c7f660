"""Execution providers of ONNX Runtime on this computer."""

from __future__ import annotations

import onnxruntime as ort

from fingerflow.errors import FingerflowError

#: Short name of the CPU provider, which is always installed.
CPU = "cpu"
_SUFFIX = "ExecutionProvider"
_REMOTE = "AzureExecutionProvider"  # runs models on a remote server, not on this computer


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
