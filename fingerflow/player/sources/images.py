"""Source for folders of images, one a frame, as camera software saves them; needs OpenCV."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import numpy as np

from fingerflow.engines.engine import Array
from fingerflow.errors import PlayerError
from fingerflow.player.sources.source import Asked, Source
from fingerflow.schema.claimed_sizes import impossible_picture

READS = "a folder of pictures"
_SUFFIXES = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".tif", ".tiff")


def reads(asked: Asked) -> bool:
    """Return whether the path is a folder."""
    return asked.path.is_dir()


def open_frames(asked: Asked) -> Source:
    """Return the images in the order of the numbers in their names; raise PlayerError if there are none."""
    try:
        importlib.import_module("cv2")
    except ImportError:
        raise PlayerError(
            f"{asked.path}: pictures need OpenCV: `pip install opencv-python-headless`, or give frames as .npy"
        ) from None
    found = [path for path in asked.path.iterdir() if path.suffix.lower() in _SUFFIXES and path.is_file()]
    if not found:
        raise PlayerError(f"{asked.path}: has no picture; of its files those that end in {', '.join(_SUFFIXES)} count")
    return ImageFiles(sorted(found, key=_by_numbers), asked.first)


class ImageFiles:
    """Sequence of image files of 8 or 16 bits; colours are converted to grey."""

    live = False

    def __init__(self, paths: list[Path], first: int) -> None:
        self._cv2 = importlib.import_module("cv2")
        self._paths, self._next = paths, first

    def read(self) -> Array | None:
        """Return the next image (H, W); None at the end."""
        if self._next >= len(self._paths):
            return None
        path = self._paths[self._next]
        try:
            data = path.read_bytes()
        except OSError as error:
            raise PlayerError(f"{path}: cannot be read ({error.strerror}); take it out of the folder") from None
        wrong = impossible_picture(data)
        if wrong:
            raise PlayerError(f"{path}: {wrong}; copy it again, or take it out of the folder")
        # OpenCV rejects an empty array.
        picture: Array | None = None
        if data:
            picture = self._cv2.imdecode(np.frombuffer(data, np.uint8), self._cv2.IMREAD_UNCHANGED)
        if picture is None:
            raise PlayerError(f"{path}: OpenCV cannot read this picture; save it again, or take it out of the folder")
        self._next += 1
        grey: Array = self._cv2.cvtColor(picture, self._cv2.COLOR_BGR2GRAY) if picture.ndim == 3 else picture
        return grey

    def close(self) -> None:
        """Do nothing: each file is closed after it was read."""


def _by_numbers(path: Path) -> list[tuple[int, str]]:
    """Return a sort key by which frame2 comes before frame10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]
