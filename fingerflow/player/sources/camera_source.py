"""Source of frames from a camera, given as any callable that returns frames."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from fingerflow.engines.engine import Array
from fingerflow.errors import PlayerError
from fingerflow.player.sources.source import Source


class CameraSource:
    """Source of frames that calls a function to grab each frame from a camera.

    It returns the next frame, or (ok, frame) as in OpenCV; its `close` is called if it has one.

    Args:
        grab: the callable.
        name: of the camera in messages.
    """

    live = True

    def __init__(self, grab: Callable[[], Any], name: str) -> None:
        self._grab, self._name = grab, name

    def read(self) -> Array | None:
        """Return the next frame (H, W); None after the last frame.

        Raises OSError where the camera reports that it has no frame now, and PlayerError where it returns another type.
        """
        frame = self._grab()
        if isinstance(frame, tuple) and len(frame) == 2 and isinstance(frame[0], (bool, np.bool_)):
            there, frame = frame
            if not there:
                raise OSError("the camera gave (False, ...) in place of a frame")
            if frame is None:
                raise self._refused("(True, None)")
        if frame is None or isinstance(frame, np.ndarray):
            return frame
        raise self._refused(f"a {type(frame).__name__}")

    def close(self) -> None:
        """Close the camera."""
        getattr(self._grab, "close", lambda: None)()

    def _refused(self, given: str) -> PlayerError:
        return PlayerError(
            f"camera {self._name!r}: gave {given} in place of a frame; it must return a NumPy array (H, W), "
            "(ok, array), or None at the end: for a list numpy.asarray(list, dtype) with the depth of the bundle"
        )


def open_camera(name: str) -> Source:
    """Open the camera given as ``module:factory``, where the factory returns a callable for `CameraSource`.

    Raises PlayerError where the factory cannot be imported or does not return a callable.
    """
    module, _, factory = name.partition(":")
    sys.path.insert(0, os.getcwd())
    try:
        make = getattr(importlib.import_module(module), factory)
    except (ImportError, AttributeError, ValueError) as error:
        raise PlayerError(f"camera {name!r}: {error}; give MODULE:FACTORY of a module in this folder") from None
    finally:
        sys.path.pop(0)
    grab = make()
    if not callable(grab):
        raise PlayerError(f"camera {name!r}: its factory gave {type(grab).__name__}; it must return a callable")
    return CameraSource(grab, name)
