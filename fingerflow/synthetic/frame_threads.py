"""Evaluation of a function of the frame number in threads, one frame each."""

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import torch


def each_frame(function: Callable[[int], Any], frames: Sequence[int]) -> Generator[Any, None, None]:
    """Yield function(frame) of each frame, in order; as many are evaluated at a time as torch has threads.

    Each evaluation uses one thread of torch: threads within an operation wait for each other, four times as long on a
    busy machine. After an interrupt, or when the generator is closed, frames not begun are left out.
    """
    threads = torch.get_num_threads()
    try:
        with ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,)) as pool:
            yield from pool.map(function, frames)
    finally:
        torch.set_num_threads(threads)
