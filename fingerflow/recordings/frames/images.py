"""A folder of images in the order in which a person would number them, or one image as a recording of one frame."""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np

from fingerflow.errors import FingerflowError
from fingerflow.recordings.frames.recording import Description, FileRecording, Frames, container_bits, grey_dtype
from fingerflow.recordings.frames.tiff import open_frames as open_tiff

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


def open_frames(path: Path, frame_rate: float | None) -> ImageRecording:
    """Open all images of a folder, or the image `path`.

    The first image is read for its size; the others are read when they are asked for, and an image of another size or
    with real colour is refused then. Raises FingerflowError for a folder without images and for one with several kinds.
    """
    files = _images_in(path) if path.is_dir() else [path]
    first = read_image(files[0])
    description = Description(
        path=path,
        count=len(files),
        frame_shape=(first.shape[0], first.shape[1]),
        dtype=first.dtype,
        bit_depth=container_bits(first.dtype),
        metadata={"first_file": files[0].name, "last_file": files[-1].name},
    )
    return ImageRecording(description, frame_rate, files)


class ImageRecording(FileRecording):
    """One file a frame."""

    def __init__(self, description: Description, frame_rate: float | None, files: list[Path]) -> None:
        super().__init__(description, frame_rate)
        self._files = files

    def _read_frame(self, index: int) -> Frames:
        image = read_image(self._files[index])
        if image.shape != self.frame_shape or image.dtype != self.dtype:
            raise FingerflowError(
                f"{self._files[index]}: is {image.shape[0]} x {image.shape[1]} {image.dtype}, but the first image, "
                f"{self._files[0].name}, is {self.frame_shape[0]} x {self.frame_shape[1]} {self.dtype}"
            )
        return image


def read_image(path: Path) -> Frames:
    """One grey image (H, W). Grey that is stored as three equal channels is kept exactly; colour is refused by name."""
    if path.suffix.lower() in (".tif", ".tiff"):
        with open_tiff(path, None) as stack:
            if len(stack) != 1:
                raise FingerflowError(f"{path}: has {len(stack)} pages; in a folder of images each file is one frame")
            return stack[0]
    # Read through NumPy: cv2.imread fails without a word for names outside the system's code page.
    image = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED) if path.stat().st_size else None
    if image is None:
        raise FingerflowError(f"{path}: cannot be read as an image; it is of another kind or damaged")
    if image.ndim == 3:
        opaque = image.shape[2] < 4 or bool(np.all(image[..., 3] == (255 if image.dtype == np.uint8 else 65535)))
        if not opaque or np.any(image[..., 1:3] != image[..., :1]):
            raise FingerflowError(f"{path}: has real colour or transparency; convert it to grey first")
        image = np.ascontiguousarray(image[..., 0])
    grey_dtype(image.dtype, path)
    return image


def _images_in(folder: Path) -> list[Path]:
    kinds: dict[str, list[Path]] = defaultdict(list)
    for file in folder.iterdir():
        if file.is_file() and file.suffix.lower() in SUFFIXES and not file.name.startswith("."):
            kinds[file.suffix.lower()].append(file)
    if not kinds:
        raise FingerflowError(f"{folder}: the folder has no images; looked for {', '.join(SUFFIXES)}")
    if len(kinds) > 1:
        counts = ", ".join(f"{len(files)} {suffix}" for suffix, files in sorted(kinds.items()))
        raise FingerflowError(f"{folder}: has images of several kinds ({counts}); leave only the frames in it")
    (files,) = kinds.values()
    return sorted(files, key=_natural)


def _natural(file: Path) -> list[tuple[int, str]]:
    """frame_2 before frame_10: runs of digits compare as numbers."""
    parts = re.split(r"(\d+)", file.name)
    return [(int(part), part) if part.isdigit() else (-1, part) for part in parts]
