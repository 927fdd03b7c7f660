"""fingerflow: contact area, skin motion and strain from high-speed recordings of a fingertip on glass."""

from importlib import import_module
from importlib.util import find_spec
from os import environ
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# ONNX Runtime 1.31 sends usage data to its maker, from threads that look up host names, unless this is set before it is
# imported.
environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

if TYPE_CHECKING:
    from fingerflow.pipeline.run import process as process
    from fingerflow.recordings import open_forces as open_forces
    from fingerflow.recordings import open_recording as open_recording
    from fingerflow.results.stream_result import open_stream as open_stream
    from fingerflow.schema.scene import load_scene as load_scene

__all__ = ["__version__", "load_scene", "open_forces", "open_recording", "open_stream", "process"]

_HOMES = {
    "process": "fingerflow.pipeline.run",
    "open_forces": "fingerflow.recordings",
    "open_recording": "fingerflow.recordings",
    "load_scene": "fingerflow.schema.scene",
    "open_stream": "fingerflow.results.stream_result",
}


def __getattr__(name: str) -> Any:
    """Import a public function on first use, so that torch is imported only when it is needed."""
    if name in _HOMES:
        try:
            return getattr(import_module(_HOMES[name]), name)
        except ModuleNotFoundError as error:
            if find_spec(f"{__name__}.pipeline") or not (error.name or "").startswith(f"{__name__}."):
                raise
            raise ImportError(
                f"{name} is not in this copy of fingerflow, the one of a deployment bundle in {__path__[0]}; install "
                "fingerflow-engine and work in another folder"
            ) from None
    raise AttributeError(f"module 'fingerflow' has no attribute {name!r}")
