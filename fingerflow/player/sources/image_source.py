"""Source of frames from a folder of image files, one image a frame; needs OpenCV."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fingerflow.engines.engine import Array
from fingerflow.errors import PlayerError
from fingerflow.player.sources.source import RecordedFrames, Source, SourceRequest
from fingerflow.recordings.guard.claimed_sizes import impossible_picture

READS = "a folder of pictures"
_SUFFIXES = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".tif", ".tiff")


def reads(asked: SourceRequest) -> bool:
    """Return whether the request is for a folder."""
    return asked.path.is_dir()


def open_frames(asked: SourceRequest) -> Source:
    """Open a folder of images as a source of frames, in the order of the numbers in the file names.

    Raise PlayerError if it holds no images.
    """
    try:
        cv2 = importlib.import_module("cv2")
    except ImportError:
        raise PlayerError(
            f"{asked.path}: pictures need OpenCV: `pip install opencv-python-headless`, or give frames as .npy"
        ) from None
    found = [path for path in asked.path.iterdir() if path.suffix.lower() in _SUFFIXES and path.is_file()]
    if not found:
        raise PlayerError(f"{asked.path}: has no picture; of its files those that end in {', '.join(_SUFFIXES)} count")
    return RecordedFrames(_images(cv2, sorted(found, key=_by_numbers)[asked.first :]))


def _images(cv2: Any, paths: list[Path]) -> Iterator[Array]:
    """Yield the images (H, W) read from files, 8 or 16 bits; colours are converted to grey."""
    for path in paths:
        try:
            data = path.read_bytes()
        except OSError as error:
            raise PlayerError(f"{path}: cannot be read ({error.strerror}); take it out of the folder") from None
        wrong = impossible_picture(data)
        if wrong:
            raise PlayerError(f"{path}: {wrong}; copy it again, or take it out of the folder")
        # OpenCV raises an error for an empty array, so it is not called.
        picture: Array | None = None
        if data:
            picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        if picture is None:
            raise PlayerError(f"{path}: OpenCV cannot read this picture; save it again, or take it out of the folder")
        yield cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) if picture.ndim == 3 else picture


def _by_numbers(path: Path) -> list[tuple[int, str]]:
    """Return a sort key that orders file names by the numbers in them: frame2 before frame10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]
