"""Source of frames from a camera: of a kind that a module of this folder opens, or any callable that returns frames."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from fingerflow.engines.engine import Array
from fingerflow.errors import PlayerError
from fingerflow.player.addresses import kinds, open_address
from fingerflow.player.named_objects import load_callable
from fingerflow.player.sources.source import Source

_SOURCES = __name__.rpartition(".")[0]


class CameraSource:
    """Source of frames that calls a function to grab each frame from a camera.

    It returns the next frame, (frame, stamp) with the camera's own time of that frame in s, or (ok, frame) as in
    OpenCV; its `close` is called if it has one.

    Args:
        grab: the callable.
        name: of the camera in messages.
    """

    live = True

    def __init__(self, grab: Callable[[], Any], name: str) -> None:
        self._grab, self._name, self.close = grab, name, getattr(grab, "close", lambda: None)
        self.stamp = math.nan

    def read(self) -> Array | None:
        """Return the next frame (H, W); None after the last frame.

        Raises OSError where the camera reports that it has no frame now, and PlayerError where it returns another type.
        """
        frame = self._grab()
        self.stamp = math.nan
        first = frame[0] if isinstance(frame, tuple) and len(frame) == 2 else None
        if isinstance(first, np.ndarray):
            frame, stamp = frame
            whole = isinstance(stamp, int) and abs(stamp) < 1e300
            if not (whole or isinstance(stamp, (float, np.integer, np.floating))):
                raise self._refused(f"a frame with the time stamp {stamp!r:.40}")
            self.stamp = float(stamp)
        elif isinstance(first, (bool, np.bool_)):
            if not first:
                raise OSError("the camera gave (False, ...) in place of a frame")
            if (frame := frame[1]) is None:
                raise self._refused("(True, None)")
        if frame is None or isinstance(frame, np.ndarray):
            return frame
        raise self._refused(f"a {type(frame).__name__}")

    def _refused(self, problem: str) -> PlayerError:
        return PlayerError(
            f"camera {self._name!r}: gave {problem} in place of a frame; it must return a NumPy array (H, W), "
            "(array, time stamp in s), (ok, array), or None at the end: for a list numpy.asarray(list, dtype) with the "
            "depth of the bundle"
        )


def open_camera(camera: str | Callable[[], Any]) -> Source:
    """Open a camera: an address such as "opencv:0", ``module:factory``, or the factory itself.

    The factory returns a callable for `CameraSource`. Raises PlayerError where it cannot be opened.
    """
    name = camera if isinstance(camera, str) else getattr(camera, "__name__", "camera")
    if isinstance(camera, str):
        if camera.partition(":")[0] in kinds(_SOURCES):
            return open_address(_SOURCES, "camera", camera)
        try:
            camera = load_callable(camera)
        except PlayerError as error:
            raise PlayerError(f"camera {name!r}: {error}") from None
    grab = camera()
    if not callable(grab):
        raise PlayerError(f"camera {name!r}: its factory gave {type(grab).__name__}; it must return a callable")
    return CameraSource(grab, name)
