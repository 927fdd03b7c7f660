"""Source of frames from a camera that OpenCV captures, such as a webcam or a network stream."""

import math

from fingerflow.engines.engine import Array
from fingerflow.errors import PlayerError
from fingerflow.player.named_objects import load_library

ADDRESS = "opencv:INDEX"


class OpenCvCamera:
    """Frame source that is a camera of this computer, given by its number, or a network stream, given by its address;
    colours are converted to grey.

    The time stamp is the driver's, where it gives one.
    """

    live = True

    def __init__(self, index: str) -> None:
        self._cv2 = load_library("cv2", "opencv-python-headless")
        self._capture = self._cv2.VideoCapture(int(index) if index.isdigit() else index)
        self.stamp, self.close = math.nan, self._capture.release
        if not self._capture.isOpened():
            raise PlayerError(f"OpenCV finds no camera {index!r}")

    def read(self) -> Array:
        """Return the next frame (H, W); raise OSError where the camera gives none."""
        there, frame = self._capture.read()
        if not there:
            raise OSError("the camera gave no frame")
        stamp = self._capture.get(self._cv2.CAP_PROP_POS_MSEC) / 1e3
        self.stamp = stamp if stamp > 0 else math.nan  # 0 and -1 mean that the camera has no stamp
        return self._cv2.cvtColor(frame, self._cv2.COLOR_BGR2GRAY) if frame.ndim == 3 else frame


open_address = OpenCvCamera
