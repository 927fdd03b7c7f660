"""Copies between the memory of the host and that of a device.

On a GPU of CUDA a copy never waits for computations that began after it: frames are copied ahead on a stream of their
own, results behind the computation on another, and the host waits for the copy that it asks for, not for the device.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from itertools import accumulate
from typing import Any

import numpy as np
import torch
from torch import Tensor

from fingerflow.engines.engine import Array

_ALIGNED = 256  # bytes; kernels read arrays that begin at multiples of it fastest


class Transfers:
    """Copies to and from a device by torch's ordinary calls; on the CPU nothing is copied."""

    def __init__(self, device: torch.device) -> None:
        self.device = device

    #: Whether the device computes and copies while the host goes on.
    behind = False

    def send(self, arrays: Sequence[Array]) -> list[Tensor]:
        """Return arrays as tensors on the device, for the computation that is launched next."""
        return [torch.from_numpy(np.asarray(one, order="C")).to(self.device) for one in arrays]

    def send_ahead(self, array: Array) -> Callable[[], Tensor]:
        """Begin to copy an array to the device, and return a function that returns the tensor for computations that are
        launched after its call.

        The tensor must not be written to: on the CPU it shares memory with the array.
        """
        there = torch.from_numpy(array).to(self.device)
        return lambda: there

    def fetch(self, tensors: Sequence[Tensor]) -> Callable[[], list[Array]]:
        """Begin to copy tensors to the host, and return a function that waits for the copies and returns them as
        arrays.
        """
        arrays = [one.detach().cpu().numpy() for one in tensors]
        return lambda: arrays


class CudaTransfers(Transfers):
    """Copies to and from a GPU of CUDA through page-locked memory, on two streams beside that of the computation.

    Arrays that are copied at the same time are packed into one copy.

    Args:
        device: the GPU.
        cuda: module `torch.cuda`.
        page_locked: whether memory of the host is page-locked, without which no copy is asynchronous.
    """

    behind = True

    def __init__(self, device: torch.device, cuda: Any = torch.cuda, page_locked: bool = True) -> None:
        super().__init__(device)
        self._cuda, self._page_locked = cuda, page_locked
        self._ahead, self._back = cuda.Stream(device), cuda.Stream(device)

    def send(self, arrays: Sequence[Array]) -> list[Tensor]:
        """Return arrays as tensors on the device, by one copy in the order of the computation."""
        if not arrays:
            return []
        places, size = places_of([one.nbytes for one in arrays])
        host = self._host(size)
        _write(host, arrays, places)
        there = torch.empty(size, dtype=torch.uint8, device=self.device)
        there.copy_(host, non_blocking=True)
        return [
            there[place : place + one.nbytes].view(_dtype(one)).view(one.shape)
            for one, place in zip(arrays, places, strict=True)
        ]

    def send_ahead(self, array: Array) -> Callable[[], Tensor]:
        host = self._host(array.nbytes)
        _write(host, [array], [0])
        event = self._cuda.Event()
        with self._cuda.stream(self._ahead):
            there = torch.empty(array.nbytes, dtype=torch.uint8, device=self.device)
            there.copy_(host, non_blocking=True)
            event.record(self._ahead)
        tensor = there.view(_dtype(array)).view(array.shape)

        def ready() -> Tensor:
            current = self._cuda.current_stream(self.device)
            current.wait_event(event)
            if tensor.is_cuda:
                tensor.record_stream(current)  # keeps the memory from being reused before `current` has read it
            return tensor

        return ready

    def fetch(self, tensors: Sequence[Tensor]) -> Callable[[], list[Array]]:
        if not tensors:
            return list
        whole, places = _packed([one.detach() for one in tensors])
        host = self._host(len(whole))
        event = self._cuda.Event()
        self._back.wait_stream(self._cuda.current_stream(self.device))
        with self._cuda.stream(self._back):
            host.copy_(whole, non_blocking=True)
            event.record(self._back)
        if whole.is_cuda:
            whole.record_stream(self._back)
        described = [(one.shape, one.dtype, one.nbytes) for one in tensors]

        def arrays() -> list[Array]:
            event.synchronize()
            return [
                host[place : place + size].view(dtype).view(shape).numpy()
                for place, (shape, dtype, size) in zip(places, described, strict=True)
            ]

        return arrays

    def _host(self, size: int) -> Tensor:
        return torch.empty(size, dtype=torch.uint8, pin_memory=self._page_locked)


@cache
def transfers_of(device: torch.device) -> Transfers:
    """Return the transfers of a device, which all engines of the process share."""
    return CudaTransfers(device) if device.type == "cuda" else Transfers(device)


def places_of(sizes: Sequence[int]) -> tuple[list[int], int]:
    """Return the first byte of each of several arrays in a common buffer, given their sizes in bytes, and the size of
    the buffer.
    """
    ends = list(accumulate((-(-size // _ALIGNED) * _ALIGNED for size in sizes), initial=0))
    return ends[:-1], ends[-1]


def as_bytes(tensor: Tensor) -> Tensor:
    """Return the bytes (n,) of a tensor, without a copy if it is contiguous."""
    return tensor.contiguous().view(-1).view(torch.uint8)


def _packed(tensors: Sequence[Tensor]) -> tuple[Tensor, list[int]]:
    """Return a buffer (n,) of bytes on the device that holds all tensors, and the first byte of each in it.

    Tensors that lie in one storage already, as the results of a captured graph do, are not copied.
    """
    storage, size = tensors[0].untyped_storage(), sum(one.nbytes for one in tensors)
    shared = len({one.untyped_storage().data_ptr() for one in tensors}) == 1
    if shared and storage.nbytes() <= size + _ALIGNED * len(tensors) and all(one.is_contiguous() for one in tensors):
        whole = torch.empty(0, dtype=torch.uint8, device=tensors[0].device).set_(storage)
        return whole, [int(one.storage_offset()) * one.element_size() for one in tensors]
    # Larger elements first: each array then begins at a multiple of its element size.
    order = sorted(range(len(tensors)), key=lambda place: -tensors[place].element_size())
    places = [0] * len(tensors)
    first = 0
    for place in order:
        places[place] = first
        first += tensors[place].nbytes
    return torch.cat([as_bytes(tensors[place]) for place in order]), places


def _write(host: Tensor, arrays: Sequence[Array], places: Sequence[int]) -> None:
    """Write arrays into a buffer of bytes, each from its first byte on."""
    buffer = host.numpy()
    for one, place in zip(arrays, places, strict=True):
        buffer[place : place + one.nbytes].view(one.dtype).reshape(one.shape)[...] = one


@cache
def _torch_dtype(dtype: np.dtype[Any]) -> torch.dtype:
    return torch.from_numpy(np.empty(0, dtype)).dtype


def _dtype(array: Array) -> torch.dtype:
    return _torch_dtype(array.dtype)
