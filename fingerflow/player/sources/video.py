"""Source for video files; needs OpenCV."""

from __future__ import annotations

import importlib
from pathlib import Path

from fingerflow.engines.engine import Array
from fingerflow.errors import PlayerError


class Video:
    """Frames of a video file, converted to grey; needs OpenCV."""

    live = False

    def __init__(self, path: Path, first: int) -> None:
        try:
            self._cv2 = importlib.import_module("cv2")
        except ImportError:
            raise PlayerError(
                f"{path}: videos need OpenCV: `pip install opencv-python-headless`, or give frames as .npy"
            ) from None
        self._capture = self._cv2.VideoCapture(str(path))
        if not self._capture.isOpened():
            raise PlayerError(f"{path}: OpenCV cannot open this video; give frames as .npy")
        for _ in range(first):
            self._capture.grab()

    def read(self) -> Array | None:
        """Return the next frame (H, W); None at the end."""
        there, frame = self._capture.read()
        if not there:
            return None
        grey: Array = self._cv2.cvtColor(frame, self._cv2.COLOR_BGR2GRAY) if frame.ndim == 3 else frame
        return grey

    def close(self) -> None:
        """Close the video."""
        self._capture.release()
