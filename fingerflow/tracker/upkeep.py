"""When a stream measures its threshold, reseeds points or takes a new key frame: by the order of the frames alone."""

from __future__ import annotations

import math


class ThresholdSearch:
    """In which frames the threshold is measured, and from which on it counts: by the order of the frames alone.

    The first frame, and every fourth then, are tried until one shows contact. What is found there, where a contact is
    small, is measured again whenever the contact has grown by a fourth.

    Methods are called for frame after frame, `due` and `wants` when it begins, `see` when it has ended.

    Args:
        lag: frames after which what one has found counts.
    """

    _EVERY, _GROWTH = 4, 1.25

    def __init__(self, lag: int) -> None:
        self._lag = lag
        self._searching = True
        self._area = math.nan  # at which the threshold was measured that is in use
        self._asked: int | None = None  # frame in which the contact had grown
        self._found: tuple[int, float] | None = None

    def begin(self) -> None:
        """Points were chosen anew: the threshold in use stays until contact is found."""
        self._searching, self._asked, self._found = True, None, None

    def due(self, index: int) -> float | None:
        """The threshold that counts from this frame on, None for that in use."""
        found = self._found
        return found[1] if found is not None and index >= found[0] + self._lag else None

    def used(self) -> None:
        """That threshold is in use now; all frames before have ended."""
        self._searching, self._area, self._asked, self._found = False, math.nan, None, None

    def wants(self, index: int) -> bool:
        """Whether the threshold is to be measured in this frame."""
        if self._searching:
            return index % self._EVERY == 0
        return self._asked is not None and index == self._asked + self._lag

    def passed_over(self) -> None:
        """A frame that does not count: where the threshold was to be measured in it, it is in a later one."""
        if self._asked is not None and self._found is None:
            self._asked = None

    def see(self, index: int, area: float, measured: float | None) -> bool:
        """The area of real contact in a frame, and the threshold found in it: NaN for none, None where nobody asked.

        True where it is to be used.
        """
        if self._found is not None:
            return False
        if measured is not None and math.isfinite(measured):
            self._found = index, measured
        elif math.isnan(self._area) or (measured is not None and not self._searching):
            self._area, self._asked = area, None
        elif not self._searching and self._asked is None and area > self._GROWTH * self._area:
            self._asked = index
        return self._found is not None


REKEY = "rekey"  # why the key frame changes while its points stay


class Upkeep:
    """When points are chosen anew or followed from a newer key frame: by the order and numbers of the frames alone.

    Args:
        share: a new key frame when less than this share of its points is tracked, several frames in a row.
        frames: a new key frame after so many frames.
    """

    _IN_A_ROW = 4  # a single frame may be blurred or dark
    _RESTART = 64  # frames between two choices of points, each of which takes as long as ten frames

    def __init__(self, share: float, frames: float) -> None:
        self._share, self._frames = share, frames
        self.key_frame = 0
        self._found = self._keyed = self._few = self._lost = self._tried = 0

    def restarted(self, index: int, key_frame: int, found: int) -> None:
        """Before frame `index` so many points were chosen in a frame."""
        self.keyed(key_frame, found)
        self._found, self._tried, self._lost = found, index, 0

    def keyed(self, key_frame: int, points: int) -> None:
        """So many points are followed from a new key frame."""
        self.key_frame, self._keyed, self._few = key_frame, points, 0

    def kept(self, index: int) -> None:
        """Before frame `index` no better points were to be had."""
        self._tried = index

    def see(self, index: int, number: int, tracked: int) -> str:
        """Why something is to change after a frame in which so many points were tracked; empty for nothing."""
        self._lost = self._lost + 1 if tracked < max(self._found / 2, 1) else 0
        self._few = self._few + 1 if tracked < self._share * self._keyed else 0
        if self._lost >= self._IN_A_ROW and index - self._tried >= self._RESTART:
            return "lost"
        if tracked and (self._few >= self._IN_A_ROW or number - self.key_frame >= self._frames):
            return REKEY
        return ""
