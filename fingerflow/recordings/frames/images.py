"""Reader of a folder of images, ordered by number, or of a single image, as a recording."""

import math
import re
from collections import Counter
from collections.abc import Sequence
from decimal import Decimal
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np

from fingerflow.errors import FingerflowError, first_line
from fingerflow.recordings.frames.recording import DamagedFrame, Description, FrameFile, Frames, Recording
from fingerflow.recordings.frames.tiff import open_frames as open_tiff
from fingerflow.recordings.guard.claimed_sizes import impossible_picture
from fingerflow.schema.text_file import check_file

_EXIF_BYTES = 1 << 17  # at the begin of a file, where its EXIF data lie
# Tag Orientation (274) of TIFF and EXIF, a number of 16 bits, in either byte order.
_ORIENTATION = re.compile(
    rb"(?s)(?:Exif\0\0|eXIf|\A)(?:II\*\0.*?\x12\x01\x03\0\x01\0\0\0(.)|MM\0\*.*?\x01\x12\0\x03\0\0\0\x01\0(.))"
)
# A number in a name: a sign, unless behind a digit, decimals and an exponent, each if there is one.
_NUMBER = re.compile(r"((?<!\d)[-+]?\d+(?:[.,]\d+)?(?:[eE][-+]\d{1,2})?)")
SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
LOSSY = (".jpg", ".jpeg")


def open_frames(path: Path) -> Recording:
    """Open a folder of images as a recording, or a single image as a recording of one frame.

    Only the first image is read, for its size; others of another size or in colour are refused when they are read. If a
    number is missing in otherwise evenly numbered names, its frame is listed in `unreadable`, so that later frames keep
    their times. If most numbers are missing, or steps are uneven, the images are read as consecutive frames, with a
    warning.

    Raises FingerflowError for a folder without images, for one with several kinds, and for equal numbers.
    """
    files, warnings = _sort_files(path) if path.is_dir() else ([path], ())
    there = [file for file in files if file is not None]
    warnings += _check_order(there)
    first = _read_image(there[0])
    with there[0].open("rb") as opened:
        turned = _ORIENTATION.search(opened.read(_EXIF_BYTES))
    description = Description(
        path=path,
        count=len(files),
        frame_shape=(first.shape[0], first.shape[1]),
        dtype=first.dtype,
        lossy="jpeg" if there[0].suffix.lower() in LOSSY else None,
        warnings=warnings,
        unreadable={index: "has no file" for index, file in enumerate(files) if file is None},
        orientation="1" if turned is None else str((turned[1] or turned[2])[0]),
        metadata={"first_file": there[0].name, "last_file": there[-1].name},
    )
    return Recording(description, FrameFile(description, partial(_read_numbered, files, description)))


def _read_numbered(files: Sequence[Path | None], first: Description, index: int) -> Frames:
    """Return frame `index` (H, W) from the image `files` of a folder; raise FingerflowError if its size or type differs
    from the first image.
    """
    file = files[index]
    assert file is not None, "a missing file is an unreadable frame"
    image = _read_image(file)
    if image.shape != first.frame_shape or image.dtype != first.dtype:
        raise FingerflowError(
            f"{file}: is {image.shape[0]} x {image.shape[1]} {image.dtype}, but the first image, "
            f"{first.metadata['first_file']}, is {first.frame_shape[0]} x {first.frame_shape[1]} {first.dtype}"
        )
    return image


def _read_image(path: Path) -> Frames:
    """Return one grey image file as an array (H, W).

    Grey stored as three equal channels is accepted without loss.

    Raises DamagedFrame where it cannot be decoded, FingerflowError for colour.
    """
    try:
        check_file(path)
        if path.suffix.lower() in (".tif", ".tiff"):
            with open_tiff(path) as stack:
                image = stack[0]
                if stack.unreadable:
                    raise DamagedFrame(f"{path}: {stack.unreadable[0]}")
                pages = len(stack)
        else:
            # Read the file with NumPy, since cv2.imread fails silently for names outside the system's code page.
            image, pages = _decoded(path, np.fromfile(path, np.uint8)), 1
    except (FingerflowError, OSError) as error:
        reason = str(error) if isinstance(error, FingerflowError) else f"{path}: {first_line(error)}"
        raise DamagedFrame(reason) from error
    if pages != 1:
        raise FingerflowError(f"{path}: has {pages} pages; in a folder of images each file is one frame")
    if image.ndim == 3:
        opaque = image.shape[2] < 4 or bool(np.all(image[..., 3] == (255 if image.dtype == np.uint8 else 65535)))
        if not opaque or np.any(image[..., 1:3] != image[..., :1]):
            raise FingerflowError(f"{path}: has real colour or transparency; convert it to grey first")
        image = np.ascontiguousarray(image[..., 0])
    return image


def _decoded(path: Path, data: np.ndarray) -> Frames:
    wrong = impossible_picture(data.data)
    if wrong:
        raise DamagedFrame(f"{path}: {wrong}; copy it again")
    try:
        cv2 = import_module("cv2")  # which a lab PC may lack
    except ImportError:
        raise FingerflowError(f"{path}: pictures need OpenCV: `pip install opencv-python-headless`") from None
    try:
        image: Frames | None = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    except cv2.error:
        image = None
    if image is None:
        raise DamagedFrame(f"{path}: cannot be read as an image; it is of another kind or damaged; copy it again")
    return image


def _sort_files(folder: Path) -> tuple[list[Path | None], tuple[str, ...]]:
    """Return the image files of a folder ordered by number, with None for missing numbers, and a list of warnings."""
    files, numbers = _numbered(list_images(folder))
    if len(numbers) < 2:
        unlike = (
            f"names of images, from {files[0].name} to {files[-1].name}, differ in more than numbers: check the order"
        )
        several = f"images from {files[0].name} to {files[-1].name} count twice: leave those of one camera or run there"
        counts = [len(set(column)) for column in zip(*(_NUMBER.findall(file.stem) for file in files), strict=False)]
        if len({_NUMBER.sub("", file.stem) for file in files}) > 1:
            return list(files), (unlike,)
        return list(files), (several,) if len(files) == math.prod(counts) > max(counts, default=0) else ()
    decimals = (
        f"the names of the images, as {files[0].name}, have decimal numbers, which order them: if these are times, "
        "they are not used; give the frame rate in recording.frame_rate"
    )
    warnings = (decimals,) if any(number != int(number) for number in numbers) else ()
    finest = Decimal(1).scaleb(min(int(number.normalize().as_tuple().exponent) for number in numbers))
    counts = [int(number / finest) for number in numbers]
    steps = np.diff(counts)
    if not steps.all():
        same = np.argmin(steps)
        raise FingerflowError(
            f"{folder}: {files[same].name} and {files[same + 1].name} have the same number; leave one of them in it"
        )
    step = int(steps.min())
    missing = (counts[-1] - counts[0]) // step + 1 - len(counts)
    uneven = bool((steps % step).any())
    if not (missing or uneven):
        return list(files), warnings
    gap = np.argmax(steps > step)
    where = f"the first between {files[gap].name} and {files[gap + 1].name}"
    if uneven or missing > len(files):
        gaps = f"the numbers of the images have gaps, {where}; they are read as consecutive frames"
        return list(files), (gaps, *warnings)
    placed: list[Path | None] = [None] * (len(files) + missing)
    for count, file in zip(counts, files, strict=True):
        placed[(count - counts[0]) // step] = file
    lacking = f"{missing} of {len(placed)} images are missing by their numbers, {where}: no frames there"
    return placed, (lacking, *warnings)


def _check_order(files: list[Path]) -> tuple[str, ...]:
    """Return a warning if the modification times of `files`, sorted by name, do not increase, as where a counter of the
    names starts again or a date in them begins with the day.

    Copies and parallel writers change the times too: times in the order of characters, most of them in disorder, or
    only neighbours exchanged, give no warning.
    """
    times = np.array([file.stat().st_mtime_ns for file in files])
    moved = np.argsort(np.argsort(times)) - np.arange(len(files))
    falls = np.flatnonzero(np.diff(times) < 0)
    disorder = 0 < len(falls) <= len(files) / 4 and abs(moved).max() >= len(files) / 4
    by_characters = times[sorted(range(len(files)), key=lambda index: files[index])]
    if not disorder or len(np.unique(times)) < len(files) or (np.diff(by_characters) > 0).all():
        return ()
    return (f"{files[falls[0] + 1].name} was written before {files[falls[0]].name}, by their times: check the order",)


def _numbered(files: list[Path]) -> tuple[list[Path], list[Decimal]]:
    """Return image files in the order of the numbers in their names, and the number of each if the names differ in one
    number only; otherwise an empty list.
    """
    parts = [_NUMBER.split(file.stem) for file in files]
    if len({tuple(part[::2]) for part in parts}) > 1:
        return sorted(files, key=_natural), []
    names = parts[0][::2]
    columns = [_values(text, [part[2 * at + 1] for part in parts]) for at, text in enumerate(names[:-1])]
    order = sorted(range(len(files)), key=lambda index: [column[index] for column in columns])
    varying = [column for column in columns if len(set(column)) > 1]
    if len(varying) > 1 or not columns:
        return [files[index] for index in order], []
    column = varying[0] if varying else columns[-1]
    return [files[index] for index in order], [column[index] for index in order]


def _values(before: str, numbers: list[str]) -> list[Decimal]:
    """Return the values of the numbers at one position of all names, which follow the text `before`.

    A hyphen behind a letter separates ("img-3") if all names have it; otherwise it is the sign of numbers before a
    trigger. A point or comma is a decimal mark; behind a constant number but 0 it separates ("cam1.9", "cam1.10")
    before what may be a counter.
    """
    if before[-1:].isalpha() and all(number.startswith("-") for number in numbers):
        numbers = [number[1:] for number in numbers]
    numbers = [number.replace(",", ".") for number in numbers]
    wholes, _, digits = zip(*(number.partition(".") for number in numbers), strict=True)
    counted = all(digit.isdecimal() and digit[0] != "0" for digit in digits) and wholes[0].strip("+-0")
    if counted and len(set(wholes)) == 1 and len(set(map(len, digits))) > 1:
        return [Decimal(digit) for digit in digits]
    return [Decimal(number) for number in numbers]


def list_images(folder: Path) -> list[Path]:
    """Return the images in a folder, without hidden files; raise FingerflowError unless it has images of one format."""
    try:
        files = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file()]
    except OSError as error:
        raise FingerflowError(f"{folder}: cannot be listed ({first_line(error)}); make it readable") from None
    files = [path for path in files if not path.name.startswith(".")]
    kinds = Counter(path.suffix.lower() for path in files)
    if not kinds:
        raise FingerflowError(f"{folder}: the folder has no images ({', '.join(SUFFIXES)}); name a file in it")
    if len(kinds) > 1:
        counts = ", ".join(f"{count} {suffix}" for suffix, count in sorted(kinds.items()))
        raise FingerflowError(f"{folder}: has images of several kinds ({counts}); leave only the frames in it")
    return files


def _natural(file: Path) -> list[tuple[int, str]]:
    """Return a sort key that orders file names by the numbers in them: frame_2 before frame_10."""
    parts = re.split(r"(\d+)", file.name)
    return [(int(part), part) if part.isdecimal() else (-1, part) for part in parts]
