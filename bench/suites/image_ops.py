"""Image operations on one frame of 512 x 640 px of a simulated press, beside OpenCV, SciPy, scikit-image and kornia.

`time_to_peer` is over the first way of each operation: OpenCV's, or SciPy's where OpenCV has none (its median of 16-bit
frames ends at 5 x 5). `same` is the share that agrees with fingerflow: of the pixels at least 4 px inside the frame, of
the pixels that a threshold splits alike, or of fingerflow's corners. 16-bit frames hold 12 bits. The contact path goes
from an 8-bit frame and the empty glass to the pixels in contact: illumination quotient, one byte a pixel, median 9 x 9,
Otsu's threshold within the lit disc, count; OpenCV's has the lit disc and the reference prepared beforehand. Corners
are 700 at most (100 with --quick) and 7 px apart, in 1024 x 1024 px (256 x 320); goodFeaturesToTrack treats the border
of the frame differently and knows no noise. Where fingerflow's compiled kernels were built they serve (the JSON record
says so), with the same threads; `FINGERFLOW_KERNELS=0` measures the portable ops.
"""

from collections.abc import Callable
from typing import NamedTuple

import cv2
import kornia
import numpy as np
import scipy.ndimage
import skimage.filters
import torch
from numpy.typing import NDArray
from torch import Tensor

from bench.opencv_contact import opencv_contact
from bench.rows import Row
from bench.timing import time_in_turns
from fingerflow.graphs import ContactGraph
from fingerflow.ops.contact.otsu import otsu_threshold
from fingerflow.ops.filters.illumination import glass_light
from fingerflow.ops.filters.median import median_filter
from fingerflow.ops.tracking.corners import detect_corners
from fingerflow.synthetic import Camera, Press

OURS = "fingerflow"
BORDER = 4  # px that libraries pad in their own way: half of the largest median window


class Operation(NamedTuple):
    """Alternative calls with the same result, the peer first: all give (H, W) images, or all (N, 2) corners."""

    name: str
    ways: dict[str, Callable[[], Tensor]]


def run(quick: bool) -> list[Row]:
    """Return a row per operation and way."""
    part = (slice(192, 320), slice(240, 400)) if quick else (slice(None), slice(None))
    eight, twelve = (Press(camera=Camera(bit_depth=bits)) for bits in (8, 12))
    frame, wide = (_view(scene, "contact", scene.render(299), part) for scene in (eight, twelve))
    empty = _view(eight, "contact", eight.empty(), part)
    skin = _view(eight, "topography", eight.render(299), part)
    operations = [
        *(_median(image, size) for image in (frame, wide) for size in (5, 9)),
        _otsu(frame),
        _contact(frame, empty),
        _corners(skin.repeat(1, 1, 2, 2)[..., :1024], 100 if quick else 700),
    ]
    rows: list[Row] = []
    for operation in operations:
        times = time_in_turns(operation.ways, next(iter(operation.ways)), rounds=2 if quick else 9)
        ours = operation.ways[OURS]()
        for name, way in operation.ways.items():
            same = None if name == OURS else _agreement(ours, way())
            rows += [{"operation": operation.name, "way": name, **times[name].cells(), "same": same}]
    return rows


def _view(scene: Press, name: str, picture: NDArray[np.integer], part: tuple[slice, slice]) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(scene.views[name].crop(picture)[part]))[None, None]


def _agreement(ours: Tensor, theirs: Tensor) -> float:
    if ours.shape[-1] == 2:
        known, found = (set(map(tuple, corners.tolist())) for corners in (theirs, ours))
        return len(known & found) / len(found)
    return (ours == theirs)[BORDER:-BORDER, BORDER:-BORDER].double().mean().item()


def _median(frame: Tensor, size: int) -> Operation:
    pixels = frame[0, 0].numpy()
    square = np.ones((size, size), dtype=bool)

    def with_kornia() -> Tensor:
        median = kornia.filters.median_blur(frame.float(), size, border_type="replicate")
        return median[0, 0].to(frame.dtype)

    ways: dict[str, Callable[[], Tensor]] = {
        "opencv": lambda: torch.from_numpy(cv2.medianBlur(pixels, size)),
        "scipy": lambda: torch.from_numpy(scipy.ndimage.median_filter(pixels, size, mode="nearest")),
        "scikit-image": lambda: torch.from_numpy(skimage.filters.rank.median(pixels, square)),
        "kornia": with_kornia,
        OURS: lambda: median_filter(frame, size)[0, 0],
    }
    if frame.dtype == torch.uint16:
        del ways["scikit-image"]  # it warns itself that it is not made for so many levels
        if size > 5:
            del ways["opencv"]
    return Operation(f"median {size} x {size}, {8 * frame.element_size()} bit", ways)


def _otsu(frame: Tensor) -> Operation:
    pixels = frame[0, 0].numpy()

    def with_opencv() -> Tensor:
        return torch.from_numpy(cv2.threshold(pixels, 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[1]) > 0

    return Operation(
        "Otsu's threshold, 8 bit",
        {
            "opencv": with_opencv,
            "scikit-image": lambda: torch.from_numpy(pixels > skimage.filters.threshold_otsu(pixels)),
            "kornia": lambda: frame[0, 0] > kornia.filters.otsu_threshold(frame)[1],
            OURS: lambda: (frame > otsu_threshold(frame)[:, None, None, None])[0, 0],
        },
    )


def _contact(frame: Tensor, empty: Tensor) -> Operation:
    graph = ContactGraph(median_px=9)
    light, black = glass_light(empty)
    limit = 1 - graph.threshold(frame, light, black)

    def with_fingerflow() -> Tensor:
        result: Tensor = graph(frame, light, black, limit).real_contact_mask[0, 0]
        return result

    return Operation("contact path, 8 bit", {"opencv": opencv_contact(frame, empty, 9), OURS: with_fingerflow})


def _corners(skin: Tensor, count: int) -> Operation:
    pixels = skin[0, 0].numpy()

    def with_opencv() -> Tensor:
        return torch.from_numpy(np.asarray(cv2.goodFeaturesToTrack(pixels, count, 0.01, 7.0, blockSize=7))[:, 0])

    def with_fingerflow() -> Tensor:
        corners = detect_corners(skin, count, 7.0, quality=0.01, window=7)
        return corners.points[0, corners.valid[0]]

    return Operation(f"{count} corners, 8 bit", {"opencv": with_opencv, OURS: with_fingerflow})
