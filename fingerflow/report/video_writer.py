"""Writer of a sequence of images to an MP4 video, by PyAV."""

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from fingerflow.results.atomic_write import MARK

RATE = 30  # frames per second


def encode_video(pictures: Iterable[NDArray[np.uint8]], path: Path) -> None:
    """Write RGB images (H, W, 3) of one size as an MP4 video; an odd last row or column is left out.

    The codec is H.264 if PyAV has it, else MPEG-4.

    Raises:
        ValueError: there is no picture.
    """
    with av.open(str(path), "w") as container:
        name = "libx264" if "libx264" in av.codecs_available else "mpeg4"
        container.metadata["comment"] = MARK
        stream = container.add_stream(name, rate=RATE)
        assert isinstance(stream, av.VideoStream)  # True for both codecs, which are video codecs
        stream.pix_fmt = "yuv420p"
        stream.time_base = Fraction(1, RATE)
        stream.bit_rate = 8_000_000
        stream.thread_type = "AUTO"
        if name == "libx264":
            # Slower presets take up to three times the processor time for 0.4 dB at this bit rate.
            stream.options = {"preset": "ultrafast"}
        height = width = 0
        for picture in pictures:
            if not height:
                height, width = (side // 2 * 2 for side in picture.shape[:2])  # video codecs need even side lengths
                stream.height, stream.width = height, width
            even = np.ascontiguousarray(picture[:height, :width])
            for packet in stream.encode(av.VideoFrame.from_ndarray(even, format="rgb24")):
                container.mux(packet)
        if not height:
            raise ValueError("a video needs a picture: none was given")
        for packet in stream.encode():
            container.mux(packet)
