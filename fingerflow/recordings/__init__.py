"""Frames and forces in: one reader a file, behind `open_recording` and `open_forces`."""

from fingerflow.recordings.forces.forces import Forces
from fingerflow.recordings.forces.opening import force_columns, open_forces
from fingerflow.recordings.frames.opening import open_recording
from fingerflow.recordings.frames.recording import Recording

__all__ = ["Forces", "Recording", "force_columns", "open_forces", "open_recording"]
