"""A camera: any callable that gives frames."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable

from ..arrays import Array
from ..errors import PlayerError
from .source import Source


class Camera:
    """Any callable that gives the next frame; `close` is called where it has one."""

    live = True

    def __init__(self, grab: Callable[[], Array | None]) -> None:
        self._grab = grab

    def read(self) -> Array | None:
        """The next frame (H, W); None at the end."""
        return self._grab()

    def close(self) -> None:
        """Lets go of the camera."""
        getattr(self._grab, "close", lambda: None)()


def open_camera(name: str) -> Source:
    """``module:factory`` called: it gives a callable that returns the next frame, or None at the end."""
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
    return Camera(grab)
