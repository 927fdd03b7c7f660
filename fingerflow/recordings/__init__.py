"""Readers of recordings and force files, one module per file format; entry points `open_recording`, `open_forces`.

A library that one format or the filter of forces needs, such as SciPy, is loaded on first use.
"""

from fingerflow.recordings.forces.forces import Forces
from fingerflow.recordings.forces.open_forces import force_columns, force_facts, holds_forces, open_forces
from fingerflow.recordings.frames.open_recording import open_recording
from fingerflow.recordings.frames.recording import Recording

__all__ = ["Forces", "Recording", "force_columns", "force_facts", "holds_forces", "open_forces", "open_recording"]
