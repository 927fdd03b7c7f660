"""Latest image and time traces of a stream, for display on the live page."""

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from fingerflow.engines.bundle import Bundle
from fingerflow.engines.engine import Array
from fingerflow.player.binary_answer import packed
from fingerflow.player.handover import Slot
from fingerflow.schema.variables import VARIABLES

_PAGE_INTERVAL = 1 / 15  # s between images of the page, which are made only while it is open
_TRACE_LENGTH = 900  # number of trace points: 30 s, as the page shows, with a point every 1 / 30 s
_PAGE_SIDE = 400  # px, longest side of the image; of larger views every 2nd, 3rd ... pixel is sent
_TRACED = ("real_contact_area", "gross_contact_area", "median_divergence")
_DRAWN = ("position_px", "divergence", "in_contact", "ellipse_center", "ellipse_semi_axes")
#: Variables that the page shows, with label, unit, factor and decimals; the page requests them once.
SHOWN = {
    name: VARIABLES[name].shown()
    for name in (*_TRACED, "divergence", "contact_threshold", "ellipse_semi_axes", "normal_force", "tangential_force",
                 "slip_flag")
}  # fmt: skip

# Function from the number of a frame to the true values by name.
Expected = Callable[[int], Mapping[str, float]]


class LiveData:
    """Latest image and time traces of a stream, written by the storing thread and read by the page server.

    Args:
        bundle: the bundle that is played.
        expected: returns the true values of a frame by name, where they are known.
        forces: names of the forces in the records.
    """

    def __init__(self, bundle: Bundle, expected: Expected | None = None, forces: Sequence[str] = ()) -> None:
        self._every = -(-max(bundle.height, bundle.width) // _PAGE_SIDE)
        self._shift = bundle.bit_depth - 8
        self._expect = expected
        self._forces = list(forces)
        self._traced = ["time", *_TRACED, *forces]
        self._asked = self._drawn = -math.inf
        self._arrays: dict[str, Array] = {}
        self._scalars: dict[str, float] = {}
        self._expected: Mapping[str, float] = {}
        self._columns = [*self._traced, *(f"expected_{name}" for name in _TRACED if expected)]
        self._traces: deque[list[float]] = deque(maxlen=_TRACE_LENGTH)

    def is_watched(self) -> bool:
        """Return whether a live page has requested data in the last two seconds."""
        return time.perf_counter() - self._asked < 2

    def is_due(self) -> bool:
        """Return whether a new image for the live page is due; if so, count the image as drawn now.

        It does if a page is open and the last image is old enough.
        """
        now = time.perf_counter()
        if not self.is_watched() or now - self._drawn < _PAGE_INTERVAL:
            return False
        self._drawn = now
        return True

    def show(self, record: Array, slot: Slot, mask: Array | None) -> None:
        """Store the downsampled 8-bit views of a frame and the results in its record as the latest image of the live
        page; `mask` is that of real contact (H, W), if the recipe exports it.
        """
        arrays = {
            name: (view[0, 0, :: self._every, :: self._every] >> self._shift).astype(np.uint8)
            for name, view in slot.views.items()
        }
        if mask is not None:
            arrays["real_contact_mask"] = mask[:: self._every, :: self._every].astype(np.uint8)
        names = record.dtype.names or ()
        arrays |= {name: record[name].astype(np.float32) for name in _DRAWN if name in names}
        self._scalars = {name: float(record[name]) for name in names if record.dtype[name].shape == ()}
        self._expected = self._expected_values(record)
        self._arrays = arrays

    def trace(self, record: Array) -> None:
        """Append contact areas, median divergence and forces from the record of a frame to the time traces of the live
        page; full traces drop the oldest entry.
        """
        names, expected = record.dtype.names or (), self._expected_values(record)
        row = [float(record[name]) if name in names else math.nan for name in self._traced]
        self._traces.append(row + ([expected.get(name, math.nan) for name in _TRACED] if self._expect else []))

    def _expected_values(self, record: Array) -> Mapping[str, float]:
        return {} if self._expect is None else self._expect(int(record["frame"]))

    def packed(self, facts: Mapping[str, Any]) -> bytes:
        """Return the latest image and the time traces, with further facts about the stream, for the live page."""
        self._asked = time.perf_counter()
        traces = np.array(list(self._traces), np.float32).reshape(-1, len(self._columns))
        values = {"scalars": self._scalars, "expected": dict(self._expected)}
        layout = {"every": self._every, "forces": self._forces, "trace_columns": self._columns}
        return packed({**facts, **values, **layout}, self._arrays | {"traces": traces})
