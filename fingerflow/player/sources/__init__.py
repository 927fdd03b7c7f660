"""Frame sources of a stream: modules in this folder that implement `Reader` are found automatically."""

from __future__ import annotations

import pkgutil
from importlib import import_module
from pathlib import Path
from typing import Protocol, cast

from fingerflow.errors import FingerflowError, PlayerError, first_line
from fingerflow.player.sources.source import Source, SourceRequest
from fingerflow.player.sources.video_source import open_video


class Reader(Protocol):
    """Interface of a module that reads one kind of frame file or folder."""

    READS: str  # kind of frames that the source reads, in a word or two

    def reads(self, asked: SourceRequest) -> bool:
        """Return whether this module reads the requested file, judged by file name and settings alone."""

    def open_frames(self, asked: SourceRequest) -> Source:
        """Open the requested file or folder as a source of frames; raise an error that names the problem if that fails.

        Errors of other types than FingerflowError may occur.
        """


def readers() -> list[Reader]:
    """Return all reader modules in alphabetical order; files that no reader module accepts go to `open_video`."""
    modules = (import_module(f"{__name__}.{found.name}") for found in pkgutil.iter_modules(__path__))
    return [cast(Reader, module) for module in modules if hasattr(module, "reads")]


def kinds() -> str:
    """Return a text for messages that lists the kinds of frame sources."""
    return f"{', '.join(one.READS for one in readers())} or a video file"


def open_source(path: Path, shape: tuple[int, int] | None, dtype: str, first: int = 0) -> Source:
    """Open a file or folder as a source of frames, from number ``first`` on.

    ``shape`` and ``dtype`` are for raw files. Raises FingerflowError where there are no frames, or none that can be
    read.
    """
    asked, known = SourceRequest(path, first, shape, dtype), readers()
    reader = next((one for one in known if one.reads(asked)), None)
    if reader is None and not path.is_file():
        raise PlayerError(f"{path}: is no file; give {kinds()}, or `synthetic`")
    try:
        return open_video(path, first) if reader is None else reader.open_frames(asked)
    except FingerflowError:
        raise
    except Exception as error:  # libraries do not specify what they raise for a damaged file
        raise PlayerError(f"{path}: cannot be read as frames ({first_line(error)}); copy or save it again") from error
