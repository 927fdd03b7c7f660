"""Warnings about results, such as contact, that were found in no frame of a stream, or in too few."""

import math
from collections import Counter, deque
from collections.abc import Iterator

import numpy as np

from fingerflow.kernels.field_limits import LEAST_SHARE
from fingerflow.schema.variables import FRAME_STATUS, USABLE
from fingerflow.tracker.area_steps import check_beginning, check_light_steps, check_missing_frames

_WIDE_MM2 = 8.0  # mm², twice a usual gauge length in diameter; a smaller contact may lack a median divergence
_AREAS = 4096  # number of latest frames whose areas are kept
_MANY = 0.05  # share of the frames with such a contact without median divergence above which this is a warning


class Findings:
    """Counter of usable and unusable frames, which also records whether points and contact were ever found.

    Attributes:
        not_usable: number of frames without results, by the names of `frame_status`.
        cut: largest share of the border of the contact that the edge of the view cuts off, and number of its frame.
    """

    def __init__(self) -> None:
        self.not_usable: Counter[str] = Counter()
        self._usable = 0
        self._last = USABLE
        self._points = self._contact = False
        self._areas: deque[tuple[int, float]] = deque(maxlen=_AREAS)  # frame number and gross area
        self._wide = self._unknown = 0  # frames with a wide contact, and those of them without median divergence
        self._first_unknown = self._last_unknown = -1
        self.cut = 0.0, 0

    def skip(self, status: int) -> bool:
        """Count an unusable frame by its status, an index into `FRAME_STATUS`; return whether the status differs from
        that of the previous frame.
        """
        self.not_usable[FRAME_STATUS[status]] += 1
        begins, self._last = status != self._last, status
        return begins

    def count(self, frame: int, tracked: int, area: float, gross_area: float, median: float, cut: float) -> None:
        """Count a usable frame by its number: number of tracked points, real and gross area in mm^2, median divergence,
        and share of the border of the contact at the edge of the view.
        """
        self.cut = max(self.cut, (cut, frame))
        self._areas.append((frame, gross_area))
        self._last = USABLE
        self._usable += 1
        self._points |= tracked > 0
        self._contact |= area > 0
        if gross_area > _WIDE_MM2:
            self._wide += 1
            if math.isnan(median):
                self._first_unknown = self._first_unknown if self._unknown else frame
                self._last_unknown = frame
                self._unknown += 1

    def area_steps(self, view_area: float, slides: bool) -> Iterator[str]:
        """Yield warnings of steps of the gross area among the latest frames, and of a stream that begins in contact, as
        `process` gives them, from the area of the view, mm^2, and whether skin slides. Safe in any thread.
        """
        areas = dict([*self._areas])
        first = max(areas, default=0) - _AREAS
        gross = np.array([areas.get(first + k, np.nan) for k in range(_AREAS + 1)])
        yield from check_light_steps(gross, view_area, first)
        if not slides:
            yield from check_missing_frames(gross, None, first)
            yield from check_beginning(gross, first) if first < 0 else ()

    def missing(self, threshold_known: bool) -> list[str]:
        """Return a warning sentence for each kind of result that was found in no frame of the stream; `threshold_known`
        tells whether a contact threshold was given or measured.
        """
        if not self._usable:
            counts = ", ".join(f"{count} {name}" for name, count in self.not_usable.items()) or "none came"
            return [
                f"no frame could be measured ({counts}): check the camera, and [background] and [views] of the scene"
            ]
        sentences = []
        if not self._points:
            sentences.append(
                "no point was found in any frame: check [views.topography] and the region of [stream], focus and light"
            )
        if not self._contact:
            sentences.append(
                "no frame showed a contact: if there was one, check [background], [views.contact] and contact.threshold"
                if threshold_known
                else "no frame showed a contact from which its threshold could be measured: areas are unknown or 0"
            )
        if self._unknown > _MANY * self._wide:
            sentences.append(
                f"{self.unknown_medians()}. Seed points where the finger touches ([stream] region), or export a bundle "
                "with more tracking.points; status says why points are lost"
            )
        return sentences

    def unknown_medians(self) -> str:
        """Return in a sentence in how many frames with a wide contact the median divergence is NaN, and why; "" if in
        none. A few such frames are no fault: a contact that is small, or that the points have just been seeded in.
        """
        if not self._unknown:
            return ""
        return (
            f"the median divergence is NaN in {self._unknown} of {self._wide} frames with a contact of more than "
            f"{_WIDE_MM2:g} mm2, the first is {self._first_unknown}, the last {self._last_unknown}: there, points with "
            f"a known divergence reach less than {LEAST_SHARE:.0%} of the contact"
        )
