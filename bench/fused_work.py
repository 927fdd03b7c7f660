"""Work of the kernels of Triton, by formulas: a dispatch mode of torch does not see what happens inside a launch.

Bytes are those of the tensors that a launch is given, each once. Operations are those of its inner loops. One that is
no product with a sum counts as two, as in the peak rate of a GPU a product with a sum is two operations. `cached` are
the bytes that the programs read and write again, which caches hold.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from types import ModuleType
from typing import Any
from unittest import mock

from torch import Tensor

from bench.devices import fused_tracking as fused_tracking_work
from bench.launches import Counter, Work, bytes_of
from fingerflow.engines.memory import FRAMES
from fingerflow.kernels.tensors import (
    fused_contact,
    fused_fits,
    fused_medians,
    fused_outliers,
    fused_pixels,
    fused_tracking,
    serving,
)

Arguments = Mapping[str, Any]  # of a kernel, by name

_PAIR = 2 * 10  # operations for the weight of a point at a position


def follow(given: Arguments, programs: int) -> Work:
    """Return the work of `fused_tracking._follow` on one of the frames that recordings have in a launch."""
    (work,) = fused_tracking_work(given["count"], given["WINDOW"], given["recordings"], FRAMES)
    return work


def local_fit(given: Arguments, programs: int) -> Work:
    """Return the work of `fused_fits._fit`: a visit of all points for the sums, and one for each covariance."""
    components, noises = given["COMPONENTS"], given["NOISES"]
    pairs = programs * given["QUERIES"] * given["count"]
    visits = components if noises else 0
    flops = pairs * (_PAIR + 2 * 16 + visits * (_PAIR + 2 * 9))
    return Work(
        _bytes(given), flops, programs, programs * given["count"] * 4 * (2 + components + noises) * (2 + visits)
    )


def fit_positions(given: Arguments, programs: int) -> Work:
    """Return the work of `fused_medians._fit_positions`: a visit of all points for 13 sums and the nearest point."""
    pairs = programs * given["QUERIES"] * given["count"]
    numbers = 4 + 3 * given["NOISE"] + 11 * given["APART"]
    flops = pairs * (_PAIR + 2 * 22 + 2 * 12 * given["APART"])
    return Work(_bytes(given), flops, programs, programs * given["count"] * 4 * numbers * 2)


def take_medians(given: Arguments, programs: int) -> Work:
    """Return the work of `fused_medians._take_medians`: two ranks by 32 bisections, and weights by 150 operations."""
    values = 8 * given["POSITIONS"]
    return Work(_bytes(given), 2 * programs * values * (2 * 32 * 3 + 150), programs)


def sum_errors(given: Arguments, programs: int) -> Work:
    """Return the work of `fused_medians._sum_errors`: a visit of all positions for two sums."""
    pairs = programs * given["QUERIES"] * given["total"]
    return Work(_bytes(given), pairs * (_PAIR + 2 * 10), programs, programs * given["total"] * 4 * 8)


def sum_blocks(given: Arguments, programs: int) -> Work:
    """Return the work of `fused_pixels._sum_blocks`: twelve operations for each pixel of every fourth line."""
    pixels = programs * given["block"] // 4 * given["width"]
    read = sum(given[name].element_size() * given[name].numel() for name in ("frames", "light", "black")) // 4
    return Work(read + bytes_of(given["sums"]), 2 * 12 * pixels, programs)


def find_mode(given: Arguments, programs: int) -> Work:
    """Return the work of `fused_pixels._find_mode`: a rank by 32 bisections, and 60 operations for each block."""
    return Work(_bytes(given), 2 * programs * given["BLOCKS"] * (32 * 3 + 60), programs)


def mark(given: Arguments, programs: int) -> Work:
    """Return the work of `fused_pixels._mark`: three numbers and twelve operations for each pixel of a window."""
    values = programs * given["PIXELS"] * (2 * given["half"] + 1) ** 2
    cached = values * sum(given[name].element_size() for name in ("frames", "light", "black"))
    return Work(_bytes(given), 2 * 12 * values, programs, cached)


def outliers(operations: int, numbers: int) -> Callable[[Arguments, int], Work]:
    """Return the formula of a kernel of `fused_outliers`, for the operations for each pair of a point and a neighbour
    and the numbers that are read for it.
    """

    def work(given: Arguments, programs: int) -> Work:
        pairs = programs * given["POINTS"] * given["NEIGHBOURS"]
        return Work(_bytes(given), 2 * operations * pairs, programs, 4 * numbers * pairs)

    return work


def segment(given: Arguments, programs: int) -> Work:
    """Return the work of `fused_contact._segment`: what a program, a frame, reads and writes of its planes, with four
    operations for each number.
    """
    cells = given["rows"] * given["columns"]

    def smoothing(size: float, half: int) -> float:
        return 6 * size * (2 * half + 2)

    blocks, steps = cells / 64, max(given["rows"], given["columns"]) / 8
    fill = cells * (1 + 2 + 1) + blocks * steps * 11
    bands = sum(cells / 4 * 5 + smoothing(cells / 4, given[half]) for half in ("narrow_half", "broad_half"))
    border = fill + cells * (11 + 2) + smoothing(cells, given["half"]) + cells * 2 + bands + 4 * cells * 5
    numbers = cells * given["CELL"] ** 2 + smoothing(cells, given["half"]) + cells * (1 + 5 + 2 * 3) + 2 * border
    numbers += fill + cells * 13
    # The planes are no traffic: they stay in a cache.
    planes = bytes_of(given["planes"])
    return Work(_bytes(given) - planes, round(programs * numbers * 2 * 4), programs, round(programs * numbers * 4))


_KERNELS: Sequence[tuple[ModuleType, str, Callable[[Arguments, int], Work]]] = (
    (fused_tracking, "_follow", follow),
    (fused_fits, "_fit", local_fit),
    (fused_medians, "_fit_positions", fit_positions),
    (fused_medians, "_take_medians", take_medians),
    (fused_medians, "_sum_errors", sum_errors),
    (fused_contact, "_segment", segment),
    (fused_pixels, "_sum_blocks", sum_blocks),
    (fused_pixels, "_find_mode", find_mode),
    (fused_pixels, "_mark", mark),
    (fused_outliers, "_fit_slopes", outliers(100, 9)),
    (fused_outliers, "_compare", outliers(60, 14)),
    (fused_outliers, "_flag", outliers(40, 13)),
)


@contextmanager
def fused_kernels(counter: Counter) -> Iterator[None]:
    """Count the launches of the kernels of Triton, which compute nothing, in place of the portable forms."""
    with ExitStack() as patches:
        patches.enter_context(mock.patch.object(serving, "is_recorded", return_value=False))
        patches.enter_context(mock.patch.object(serving, "_is_on_gpu", lambda tensor: tensor.is_meta))
        for module, name, work in _KERNELS:
            counted = _Counted(getattr(module, name).arg_names, work, counter)
            patches.enter_context(mock.patch.object(module, name, counted))
        yield


class _Counted:
    """Kernel of Triton that adds the work of a launch to a counter in place of launching."""

    def __init__(self, names: Sequence[str], work: Callable[[Arguments, int], Work], counter: Counter) -> None:
        self._names, self._work, self._counter = names, work, counter

    def __getitem__(self, grid: tuple[int, ...]) -> Callable[..., None]:
        def launch(*given: Any, **constants: Any) -> None:
            named = dict(zip(self._names, given, strict=False)) | constants
            self._counter.work.append(self._work(named, math.prod(grid)))

        return launch


def _bytes(given: Arguments) -> int:
    """Return the bytes of the tensors of a launch, of one that is given twice once."""
    return sum(map(bytes_of, {id(one): one for one in given.values() if isinstance(one, Tensor)}.values()))
