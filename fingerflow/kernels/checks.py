"""Check the arrays passed to kernels, and convert them to kernel arguments."""

from fingerflow.kernels.arrays import (
    KINDS,
    Array,
    Shaped,
    in_one_piece,
    kind,
    range_of,
    rows_in_one_piece,
    strides_of_rows,
)
from fingerflow.kernels.library import values_are_known

FRAME_KINDS = {"uint8": 0, "uint16": 1, "int32": 2, "float32": 3}  # codes of kernels/pixels.h


def check_frames(frames: Shaped, kinds: tuple[str, ...] = tuple(FRAME_KINDS)) -> None:
    """Raise TypeError unless the dtype of frames is one of `kinds`, ValueError unless the shape is (B, 1, H, W)."""
    if kind(frames) not in kinds:
        raise TypeError(f"frames are {kind(frames)}: this compiled kernel takes {' or '.join(kinds)}")
    if frames.ndim != 4 or frames.shape[1] != 1:
        raise ValueError(f"frames have shape {tuple(frames.shape)}: give (B, 1, H, W)")


def check_axes(name: str, array: Shaped, count: int) -> None:
    """Raise ValueError if an array does not have `count` axes."""
    if array.ndim != count:
        raise ValueError(f"{name} has shape {tuple(array.shape)}: an array of {count} axes is needed")


def check_like(name: str, array: Shaped, of: str, shape: tuple[int, ...]) -> None:
    """Raise ValueError unless an array has the dtype `of`, such as "float32", and the given shape; `name` names the
    array in the message.
    """
    if KINDS[array.dtype] != of or array.shape != shape:
        raise ValueError(f"{name} is {kind(array)} {tuple(array.shape)}: {of} {shape} is needed")


def checked(name: str, array: Array, of: str, shape: tuple[int, ...]) -> Array:
    """Check the dtype and shape of an array, and return the array, copied if it is not contiguous.

    Raises:
        ValueError: wrong dtype or shape.
    """
    check_like(name, array, of, shape)
    return in_one_piece(array)


def check_indices(name: str, index: Shaped, count: int, of: str) -> None:
    """Raise ValueError unless all indices (N, ...) lie from 0 to `count` - 1.

    `of` names the indexed things in the message.
    """
    if values_are_known() and index.shape[0]:
        lowest, highest = range_of(index)
        if not 0 <= lowest <= highest < count:
            raise ValueError(
                f"{name} of {count} {of} go from {lowest} to {highest}: they must lie from 0 to {count - 1}"
            )


def described(frames: Array) -> dict[str, Array | int]:
    """Return the fields of the C structure `fingerflow_frames` that describe frames (B, 1, H, W) with contiguous rows:
    data, sizes, strides and dtype.
    """
    batch, _, height, width = frames.shape
    frame_stride, row_stride = strides_of_rows(frames)
    return {
        "data": frames,
        "batch": batch,
        "height": height,
        "width": width,
        "frame_stride": frame_stride,
        "row_stride": row_stride,
        "kind": FRAME_KINDS[kind(frames)],
    }


def lit(frames: Array, light: Array, black: Array) -> dict[str, Array | int]:
    """Check frames (B, 1, H, W) with the light of the empty glass and the black level, images for one or all frames;
    return the fields of the C structure `fingerflow_lit_frames`.

    Raises:
        TypeError, ValueError: wrong dtype, or inconsistent shapes.
    """
    check_frames(frames)
    for name, image in (("light", light), ("black", black)):
        if kind(image) != "float32":
            raise TypeError(f"{name} is {kind(image)}: float32 is needed")
        if image.shape[1:] != frames.shape[1:] or image.shape[0] not in (1, frames.shape[0]):
            raise ValueError(f"{name} of {tuple(image.shape)} beside frames of {tuple(frames.shape)}")
    return {
        **described(rows_in_one_piece(frames)),
        "light": in_one_piece(light),
        "black": in_one_piece(black),
        "lights": light.shape[0],
        "blacks": black.shape[0],
    }


def mask_of(frames: Array, mask: Array) -> Array:
    """Check that a mask (B or 1, 1, H, W) bool fits the frames, and return the mask with contiguous rows."""
    check_frames(mask, ("bool",))
    if mask.shape[1:] != frames.shape[1:] or mask.shape[0] not in (1, frames.shape[0]):
        raise ValueError(f"a mask of {tuple(mask.shape)} beside frames of {tuple(frames.shape)}")
    return rows_in_one_piece(mask)


def described_mask(mask: Array | None) -> dict[str, Array | int | None]:
    """Return the kernel arguments for a mask: data, number of images, and image and row strides in pixels."""
    names = ("mask", "masks", "mask_stride", "mask_row_stride")
    if mask is None:
        return dict(zip(names, (None, 0, 0, 0), strict=True))
    return dict(zip(names, (mask, mask.shape[0], *strides_of_rows(mask)), strict=True))
