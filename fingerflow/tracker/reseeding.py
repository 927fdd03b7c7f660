"""Schedule contact thresholds, reseedings and new key frames of a stream."""

import math


class ThresholdSearch:
    """Schedule of the contact threshold in a stream: when it is measured, and from which frame on it applies.

    The first frame and every fourth after it are tried until one shows contact. A threshold measured in a small contact
    is measured again whenever the contact has grown by a fourth.

    Methods are called for one frame after another: `due` and `wants` when it begins, `update` when it has ended.

    Args:
        lag: frames after which a measured threshold applies.

    Attributes:
        EVERY: number of frames between two trials.
    """

    EVERY = 4
    _GROWTH = 1.25

    def __init__(self, lag: int) -> None:
        self._lag = lag
        self._searching = True
        self._area = math.nan  # px, contact area with which later areas are compared
        self._asked: int | None = None  # index of the frame in which the contact had grown
        self._found: tuple[int, float] | None = None

    def begin(self) -> None:
        """Restart the search for a threshold after a reseeding; the threshold in use stays until contact is found."""
        self._searching, self._asked, self._found = True, None, None

    def due(self, index: int) -> float | None:
        """Return the new threshold that applies from frame `index` on; None if the threshold in use stays."""
        measured = self._found
        return measured[1] if measured is not None and index >= measured[0] + self._lag else None

    def used(self) -> None:
        """Record that the new threshold is now in use."""
        self._searching, self._area, self._asked, self._found = False, math.nan, None, None

    def wants(self, index: int) -> bool:
        """Return whether the threshold is to be measured in frame `index`."""
        if self._searching:
            return index % self.EVERY == 0
        return self._asked is not None and index == self._asked + self._lag

    def passed_over(self) -> None:
        """Record that a frame is not usable; a threshold measurement planned in this frame moves to a later one."""
        if self._found is None:
            self._asked = None

    def update(self, index: int, area: float, measured: float | None) -> bool:
        """Add a frame with its contact area, px; return whether the contact threshold measured in this frame is to be
        used.

        `measured` is the threshold found in it, NaN for none, None if it was not measured.
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


REKEY = "rekey"  # cause of a new key frame for the same points
CONTACT = "contact"  # cause of a reseeding at the place where the contact lies


class ReseedingSchedule:
    """Schedule of reseedings and new key frames in a stream, by the number of tracked points and of frames.

    Args:
        share: a new key frame is taken when less than this share of its points is tracked, several frames in a row.
        frames: a new key frame is taken after so many frames.
    """

    _IN_A_ROW = 4  # number of frames in a row: a single frame may be blurred or dark
    _RESTART = 64  # least number of frames between two seedings, each of which takes as long as ten frames
    # Number of evaluations with too few points before a reseeding, since a growing contact may pass the limit twice.
    _LOOKS = 2
    _YOUNG = 16  # number of evaluations of one contact after which it is not reseeded, as its skin has deformed already

    def __init__(self, share: float, frames: float) -> None:
        self._share, self._frames = share, frames
        self.key_frame = 0
        self._found = self._keyed = self._few = self._lost = self._tried = self._sparse = self._looks = 0

    def restarted(self, index: int, key_frame: int, points: int) -> None:
        """Record that, before frame `index`, new points were seeded: `points` points in the image of frame number
        `key_frame`.
        """
        self.keyed(key_frame, points)
        self._found, self._tried, self._lost, self._sparse = points, index, 0, 0

    def keyed(self, key_frame: int, points: int) -> None:
        """Record a new key frame, and the number of points tracked from this frame."""
        self.key_frame, self._keyed, self._few = key_frame, points, 0

    def keep(self, index: int) -> None:
        """Record that the current points were kept at frame `index`: reseeding would not have given more."""
        self._tried = index

    def record_contact(self, touching: bool, sparse: bool) -> None:
        """Record an evaluation of the contact in one frame: whether there is contact, and whether too few tracked
        points lie in it.
        """
        self._looks = self._looks + 1 if touching else 0
        if not touching:
            self._sparse = 0
        elif sparse and self._looks <= self._YOUNG:
            self._sparse += 1

    def update(self, index: int, number: int, tracked: int) -> str:
        """Record that `tracked` points were tracked in a frame; return the cause of the reseeding or new key frame that
        is now due, "" for none.

        Causes are "lost", `CONTACT` and `REKEY`.
        """
        self._lost = self._lost + 1 if tracked < max(self._found / 2, 1) else 0
        self._few = self._few + 1 if tracked < self._share * self._keyed else 0
        if self._lost >= self._IN_A_ROW and index - self._tried >= self._RESTART:
            return "lost"
        if self._sparse >= self._LOOKS:
            self._sparse, self._looks = 0, self._YOUNG
            return CONTACT
        if tracked and (self._few >= self._IN_A_ROW or number - self.key_frame >= self._frames):
            return REKEY
        return ""
