"""What functions of kernels ask of their tensors, and how they describe them."""

import torch
from torch import Tensor

from fingerflow.kernels.library import CPU, values_are_known

FRAME_KINDS = {torch.uint8: 0, torch.uint16: 1, torch.int32: 2, torch.float32: 3}  # of kernels/pixels.h


def empty(dtype: torch.dtype, *shape: int) -> Tensor:
    """A result, of a dtype and a device that torch's defaults do not touch."""
    return torch.empty(shape, dtype=dtype, device=CPU)


def check_frames(frames: Tensor, dtypes: tuple[torch.dtype, ...]) -> None:
    """Raises TypeError for another dtype, ValueError for a shape other than (B, 1, H, W)."""
    if frames.dtype not in dtypes:
        raise TypeError(f"frames are {frames.dtype}: this compiled kernel takes {' or '.join(map(str, dtypes))}")
    if frames.ndim != 4 or frames.shape[1] != 1:
        raise ValueError(f"frames have shape {tuple(frames.shape)}: give (B, 1, H, W)")


def check_like(name: str, tensor: Tensor, dtype: torch.dtype, shape: tuple[int, ...]) -> None:
    """Raises ValueError for another dtype or shape."""
    if tensor.dtype != dtype or tensor.shape != shape:
        raise ValueError(f"{name} is {tensor.dtype} {tuple(tensor.shape)}: {dtype} {shape} is needed")


def check_indices(name: str, index: Tensor, count: int, of: str) -> None:
    """Raises ValueError for an index that is not from 0 to below the `count` of what `of` says."""
    if values_are_known() and index.numel():
        lowest, highest = (int(end) for end in index.aminmax())
        if not 0 <= lowest <= highest < count:
            raise ValueError(
                f"{name} of {count} {of} go from {lowest} to {highest}: they must lie from 0 to {count - 1}"
            )


def rows_in_one_piece(frames: Tensor) -> Tensor:
    """The frames themselves where pixels of a row are neighbours in memory, else a copy."""
    one_piece = frames.stride(3) == 1 or frames.shape[3] == 1
    return frames if one_piece else frames.contiguous()


def extent(frames: Tensor) -> dict[str, int]:
    """Batch, height, width, and the strides of a frame and of a row in pixels."""
    batch, _, height, width = frames.shape
    frame_stride, _, row_stride, _ = frames.stride()
    return {"batch": batch, "height": height, "width": width, "frame_stride": frame_stride, "row_stride": row_stride}


def described(frames: Tensor) -> dict[str, Tensor | int]:
    """`fingerflow_image` of frames with rows in one piece."""
    frame_stride, _, row_stride, _ = frames.stride()
    strides = {"image_stride": frame_stride, "row_stride": row_stride}
    return {"data": frames, "count": frames.shape[0], **strides, "kind": FRAME_KINDS[frames.dtype]}


def mask_of(frames: Tensor, mask: Tensor) -> Tensor:
    """The mask (B or 1, 1, H, W) bool of frames, checked, pixels of a row neighbours in memory."""
    check_frames(mask, (torch.bool,))
    if mask.shape[1:] != frames.shape[1:] or mask.shape[0] not in (1, frames.shape[0]):
        raise ValueError(f"a mask of {tuple(mask.shape)} beside frames of {tuple(frames.shape)}")
    return rows_in_one_piece(mask)


def described_mask(mask: Tensor | None) -> dict[str, Tensor | int | None]:
    """The mask, its number of images, strides of an image and of a row."""
    names = ("mask", "masks", "mask_stride", "mask_row_stride")
    if mask is None:
        return dict(zip(names, (None, 0, 0, 0), strict=True))
    return dict(zip(names, (mask, mask.shape[0], mask.stride(0), mask.stride(2)), strict=True))
