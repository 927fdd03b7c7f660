"""Reader of TIFF stacks with one page per frame, including ImageJ stacks and BigTIFF."""

import logging
import math
import re
import struct
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from fingerflow.errors import FingerflowError
from fingerflow.recordings.forces.open_forces import TO_SECONDS
from fingerflow.recordings.frames.recording import (
    DamagedFrame,
    Description,
    FrameFile,
    Frames,
    Recording,
    grey_dtype,
    surplus,
)
from fingerflow.recordings.guard.file_checks import plausible_size, reading

LOSSY = ("JPEG", "OJPEG", "JPEG_LOSSY", "ALT_JPEG", "WEBP")  # tifffile's names of lossy compressions
GREY = (tifffile.PHOTOMETRIC.MINISBLACK, tifffile.PHOTOMETRIC.MINISWHITE)


def open_frames(path: Path) -> Recording:
    """Open a TIFF stack, reading the page tags only; raise FingerflowError unless all pages are grey frames of one
    shape and type.

    The rate is from ImageJ's `finterval` or OME's `TimeIncrement`, the time between two frames, if present; ImageJ's
    `fps` is the speed of playback and is ignored. The bit depth is the tag BitsPerSample.
    """
    complaints: list[str] = []  # messages of tifffile about a damaged file

    def collect(record: logging.LogRecord) -> bool:
        complaints.append(record.getMessage())
        return False

    logger = logging.getLogger("tifffile")
    logger.addFilter(collect)
    try:
        with ExitStack() as opened, reading(path, "TIFF"):
            file = opened.enter_context(tifffile.TiffFile(path))
            description, frames = _describe(path, file, _check_chain(path, file), complaints)
            if isinstance(frames, np.ndarray):
                return Recording(description, FrameFile(description, frames))
            opened.pop_all()
            pages = partial(_page, frames, description.frame_shape)
            return Recording(description, FrameFile(description, pages, file.close))
    finally:
        logger.removeFilter(collect)


def _page(pages: Sequence[Any], shape: tuple[int, int], index: int) -> Frames:
    """Decode page `index` of a TIFF stack and return it as a frame (H, W) of the given shape."""
    image = np.asarray(pages[index].asarray())
    if image.size != shape[0] * shape[1]:
        raise DamagedFrame(f"is {image.shape} and not {shape}")
    return image.reshape(shape)


def _check_chain(path: Path, file: tifffile.TiffFile) -> set[int]:
    """Return the byte positions of all page headers in a TIFF file, each of which refers to the next one; raise
    FingerflowError if they form a loop.

    tifffile checks for loops only at the hundredth page, and not at all where it takes pages one by one.
    """
    layout, handle, size = file.tiff, file.filehandle, path.stat().st_size
    seen: set[int] = set()
    offset = file.pages.first.offset
    while 0 < offset < size:
        if offset in seen:
            raise FingerflowError(
                f"{path}: page {len(seen)} is followed by the one at byte {offset}, which came before; copy or "
                "export the file again"
            )
        seen.add(offset)
        handle.seek(offset)
        tags = struct.unpack(layout.tagnoformat, handle.read(layout.tagnosize))[0]
        handle.seek(offset + layout.tagnosize + tags * layout.tagsize)
        following = handle.read(layout.offsetsize)
        if len(following) < layout.offsetsize:  # the file ends here, which tifffile reports
            break
        offset = struct.unpack(layout.offsetformat, following)[0]
    return seen


def _describe(
    path: Path, file: tifffile.TiffFile, headers: set[int], complaints: list[str]
) -> tuple[Description, Sequence[Any] | Frames]:
    """Return the metadata of an open TIFF stack, and its frames, either as one memory map (N, H, W) or as pages that
    must be decoded one by one.

    The file positions of the page `headers` show whether data follow the last frame; `complaints` are the messages of
    tifffile about damage.
    """
    series: Any = file.series
    if not series:
        raise FingerflowError(f"{path}: has no readable page; it ends after {path.stat().st_size} bytes")
    kinds = {(part.shape, part.axes, str(part.dtype), part.keyframe.photometric) for part in series}
    if len(kinds) > 1:
        shapes = ", ".join(f"{len(part.pages)} of {part.shape}" for part in series[:4])
        raise FingerflowError(f"{path}: its pages differ ({shapes}); all frames have one size and kind")
    stack, page = series[0], series[0].keyframe
    if page.photometric not in GREY or page.samplesperpixel != 1:
        colour = f"{getattr(page.photometric, 'name', page.photometric)}, {page.samplesperpixel} samples a pixel"
        raise FingerflowError(f"{path}: a colour file ({colour}); convert it to grey first")
    *leading, height, width = stack.shape if len(stack.shape) > 1 else (0, 0)
    # A program that writes page by page may make each page a series; the frames are then the pages of all series.
    alone = len(series) == 1
    if sum(length > 1 for length in (*leading, *([] if alone else [len(series)]))) > 1 or (
        stack.axes[-2:] != "YX" or page.imagedepth > 1
    ):
        raise FingerflowError(f"{path}: its axes {stack.axes} are {stack.shape}; frames have one axis before YX")
    dtype = grey_dtype(np.dtype(stack.dtype), path)
    if min(height, width) < 1:
        raise FingerflowError(f"{path}: frames of {height} x {width} pixels cannot be; copy the file again")
    imagej = file.imagej_metadata or {}
    ome = file.ome_metadata or ""
    count = math.prod(leading) * len(series)
    one_piece = alone and stack.dataoffset is not None
    frame_bytes = height * width * dtype.itemsize
    if count == 1 and one_piece:
        # ImageJ stores contiguous pixels, then the list of pages; if only the list is cut off, the count is still
        # known.
        count = max(count, int(imagej.get("images", 1)))
    size = path.stat().st_size
    frames: Sequence[Any] | Frames = []
    damaged: dict[int, str] = {}
    if one_piece:
        whole = min(count, (size - stack.dataoffset) // frame_bytes)
        shape = (max(whole, 0), height, width)
        if whole > 0:
            frames = np.memmap(path, dtype.newbyteorder(file.byteorder), "r", stack.dataoffset, shape)
        end = stack.dataoffset + count * frame_bytes
    else:
        frames = [part for each in series for part in each.pages]
        states = [_damage(part, size, frame_bytes) for part in frames]
        whole = max((number + 1 for number, state in enumerate(states) if not state), default=0)
        frames = frames[:whole]
        damaged = {number: state for number, state in enumerate(states[:whole]) if state}
        pieces = sorted(  # first byte, end and frame of each strip or tile, the parts in which a page is stored
            (offset, offset + length, number)
            for number, part in enumerate(frames)
            if number not in damaged
            for offset, length in zip(part.dataoffsets, part.databytecounts, strict=True)
        )
        for (begin, behind, number), (following, *_, successor) in pairwise(pieces):
            if begin < following < behind:
                damaged |= dict.fromkeys((number, successor), "lies in the same bytes as another frame, or as itself")
        end = max((behind for _, behind, _ in pieces), default=0)
    if whole <= 0:
        raise FingerflowError(f"{path}: not one of its {count} frames is there whole; copy the file again")
    stored = sum(page.databytecounts)
    warnings = list(surplus(min((at for at in headers if at >= end), default=size) - end, max(stored, 1), count))
    expected = height * -(-width * int(page.bitspersample) // 8)  # packed rows end with a whole byte
    if page.compression == tifffile.COMPRESSION.NONE and not page.is_tiled and stored != expected:
        warnings.append(
            f"a frame of {height} x {width} {dtype} has {expected} bytes, and the file states {stored}: its header "
            "is damaged, or not of these pixels"
        )
    if "C" in stack.axes and stack.shape[stack.axes.index("C")] > 1:
        warnings.append(f"the file calls its {count} images channels; they are read as frames")
    if "DeltaT=" in ome:
        warnings.append("the times of frames in the file (DeltaT) are not used: check recording.frame_rate")
    if complaints and whole == count:
        warnings.append(f"truncated or damaged: frames after the last of {whole} may be missing ({complaints[0]})")
    if page.photometric == tifffile.PHOTOMETRIC.MINISWHITE:
        warnings.append("the file declares 0 as white: grey values are kept as stored, so larger ones are darker")
    description = Description(
        path=path,
        count=whole,
        stated_count=count,
        frame_shape=(height, width),
        dtype=dtype,
        bit_depth=page.bitspersample,
        frame_rate=_rate(imagej, ome),
        lossy=page.compression.name.lower() if page.compression.name in LOSSY else None,
        unreadable=damaged,
        orientation=str(page.tags.valueof("Orientation", 1)),
        warnings=tuple(warnings),
        metadata={"axes": stack.axes},
    )
    return description, frames


def _damage(page: Any, size: int, frame_bytes: int) -> str:
    """Return why the pixels of a TIFF page cannot be read, judged by its header, the file size and the bytes of a
    frame; "" if no damage is found.
    """
    if page is None:
        return "has no readable header"
    pieces = list(zip(page.dataoffsets, page.databytecounts, strict=False))
    if len(pieces) != math.prod(page.chunked):  # tifffile reads as many pieces as the header lists, without an error
        return f"has {len(pieces)} of {math.prod(page.chunked)} pieces"
    if not all(offset > 0 and length > 0 for offset, length in pieces):
        return "was never written"  # tifffile would return zeros for them
    if not all(offset + length <= size for offset, length in pieces):
        return "ends beyond the file"
    if not plausible_size(frame_bytes, sum(length for _, length in pieces)):
        return "has fewer bytes than a frame of its size"
    return ""


def _rate(imagej: dict[str, Any], ome: str) -> float | None:
    stated: dict[str, Any] = dict(re.findall(r'(TimeIncrement\w*)="([^"]*)"', ome)) | imagej
    # Without the end of "sec" and "msec".
    unit = str(stated.get("tunit", stated.get("TimeIncrementUnit", "s"))).replace("\\u00B5", "u").removesuffix("ec")
    with suppress(TypeError, ValueError):
        interval = TO_SECONDS.get(unit, 0) * float(stated.get("finterval", stated.get("TimeIncrement", 0)))
        return 1.0 / interval if interval > 0 else None
    return None
