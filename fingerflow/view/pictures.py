"""Frames of a recording as 8-bit grey images for display, all with one contrast."""

import numpy as np
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.recordings import Recording

_MOST_SIDE = 1400  # px, longest side of an image; larger frames are subsampled
_STEP = 4  # px, step between the pixels that set the contrast
_DARKEST, _BRIGHTEST = 0.2, 99.9  # percentiles of the grey levels that are drawn black and white


class Pictures:
    """Converter of a recording's frames to 8-bit images for display, subsampled to a limited size.

    Attributes:
        every: subsampling step along both axes, px.
    """

    def __init__(self, recording: Recording) -> None:
        """Set the contrast from the first and the middle frame; raise FingerflowError if no frame can be read."""
        if not len(recording):
            raise FingerflowError(f"{recording.path} has no frame; copy it again, or name another recording")
        self.recording = recording
        self.every = -(-max(recording.frame_shape) // _MOST_SIDE)
        samples = [recording[k][::_STEP, ::_STEP] for k in (0, len(recording) // 2)]
        counts = np.concatenate([sample[np.isfinite(sample)] for sample in samples])
        low, high = np.percentile(counts, (_DARKEST, _BRIGHTEST)) if counts.size else (0.0, 1.0)
        self._low, self._scale = float(low), 255 / max(float(high - low), 1e-9)

    def picture(self, frame: int) -> NDArray[np.uint8]:
        """Return a frame of the recording, given by its index in the file, as an 8-bit image (h, w), subsampled by
        `every`, with the recording's contrast.
        """
        shown = self.recording[frame][:: self.every, :: self.every]
        grey = (shown.astype(np.float32) - self._low) * self._scale
        return np.clip(np.nan_to_num(grey), 0, 255).astype(np.uint8)
