"""Source of frames from video files; needs OpenCV."""

from __future__ import annotations

import importlib
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fingerflow.engines.engine import Array
from fingerflow.errors import PlayerError
from fingerflow.player.sources.source import RecordedFrames, Source

log = logging.getLogger("fingerflow.player")


def open_video(path: Path, first: int) -> Source:
    """Open a video file as a source of frames from number `first` on; raise PlayerError if OpenCV cannot open it."""
    try:
        cv2 = importlib.import_module("cv2")
    except ImportError:
        raise PlayerError(
            f"{path}: videos need OpenCV: `pip install opencv-python-headless`, or give frames as .npy"
        ) from None
    capture = cv2.VideoCapture(str(path))
    if not capture.isOpened():
        raise PlayerError(f"{path}: OpenCV cannot open this video; give frames as .npy")
    for _ in range(first):
        capture.grab()
    return RecordedFrames(_frames(cv2, capture, path, first), capture.release)


def _frames(cv2: Any, capture: Any, path: Path, number: int) -> Iterator[Array]:
    """Yield the grey frames (H, W) from `number` on; log a message if the video has fewer frames than stated."""
    stated = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    while (read := capture.read())[0]:
        frame, number = read[1], number + 1
        yield cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) if frame.ndim == 3 else frame
    if number < stated - 1:  # some containers state only a duration, from which OpenCV rounds the number of frames
        log.warning("%s: ends after %d of %d frames, as it is damaged or cut; copy it again", path, number, stated)
