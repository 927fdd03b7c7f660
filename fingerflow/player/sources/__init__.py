"""Sources of frames. A module of this folder that has what `Reader` has is a source, and nothing else lists it."""

from __future__ import annotations

import pkgutil
from importlib import import_module
from pathlib import Path
from typing import Protocol, cast

from fingerflow.errors import PlayerError, first_line
from fingerflow.player.sources import video
from fingerflow.player.sources.source import Asked, Source


class Reader(Protocol):
    """What a module states that reads a kind of file or folder."""

    READS: str  # the kind, in a word or two

    def reads(self, asked: Asked) -> bool:
        """Whether this is of its kind, by its name and without reading it."""

    def open_frames(self, asked: Asked) -> Source:
        """Raises PlayerError, or OSError, TypeError or ValueError with what is wrong about the file."""


def readers() -> list[Reader]:
    """In the order of their names. OpenCV, in `video`, tries what none of them reads."""
    modules = (import_module(f"{__name__}.{found.name}") for found in pkgutil.iter_modules(__path__))
    return [cast(Reader, module) for module in modules if hasattr(module, "reads")]


def kinds() -> str:
    """What can be played, in words."""
    return f"{', '.join(one.READS for one in readers())} or a video file"


def open_recording(path: Path, shape: tuple[int, int] | None, dtype: str, first: int = 0) -> Source:
    """The frames of a file or folder from number ``first`` on; ``shape`` and ``dtype`` are those of a raw file.

    Raises PlayerError where there is none, or none that can be read.
    """
    asked, known = Asked(path, first, shape, dtype), readers()
    reader = next((one for one in known if one.reads(asked)), None)
    if reader is None and not path.is_file():
        raise PlayerError(f"{path}: is no file; give {kinds()}, or `synthetic`")
    try:
        return video.Video(path, first) if reader is None else reader.open_frames(asked)
    except PlayerError:
        raise
    except Exception as error:  # what a library raises at a damaged file is no promise of its own
        raise PlayerError(
            f"{path}: cannot be read as frames ({first_line(error)}); copy it again, or save it anew"
        ) from error
