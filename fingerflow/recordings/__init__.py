"""Readers of recordings and force files, one module per file format; entry points `open_recording`, `open_forces`.

Names are loaded on first use: code that reads only frames needs no library for forces, such as SciPy.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fingerflow.recordings.forces.forces import Forces as Forces
    from fingerflow.recordings.forces.open_forces import force_columns as force_columns
    from fingerflow.recordings.forces.open_forces import force_facts as force_facts
    from fingerflow.recordings.forces.open_forces import holds_forces as holds_forces
    from fingerflow.recordings.forces.open_forces import open_forces as open_forces
    from fingerflow.recordings.frames.open_recording import open_recording as open_recording
    from fingerflow.recordings.frames.recording import Recording as Recording

_HOMES = {
    "Forces": "fingerflow.recordings.forces.forces",
    "force_columns": "fingerflow.recordings.forces.open_forces",
    "force_facts": "fingerflow.recordings.forces.open_forces",
    "holds_forces": "fingerflow.recordings.forces.open_forces",
    "open_forces": "fingerflow.recordings.forces.open_forces",
    "open_recording": "fingerflow.recordings.frames.open_recording",
    "Recording": "fingerflow.recordings.frames.recording",
}
__all__ = ["Forces", "Recording", "force_columns", "force_facts", "holds_forces", "open_forces", "open_recording"]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}; public are {', '.join(__all__)}")
