"""An engine that knows where points are, for tests of what the tracker decides."""

from collections.abc import Callable
from typing import Any

import numpy as np

from fingerflow.engines.engine import Corrected, EngineSettings, Followed, FoundPoints, KeyFrame
from fingerflow.kernels.tracking_limits import NUMBERS, REACH, ROUNDS, TrackStatus

Array = np.ndarray[Any, Any]
_HALF_A_RIDGE = 5.0  # px, distance within which a look approaches a point
_STEP = 1.5  # px, largest step of a look


class Templates:
    """Numbers (N, NUMBERS) of the templates of N points, all 0."""

    def __init__(self, count: int) -> None:
        self.numbers = np.zeros((count, NUMBERS), np.float32)


class KnownSkin:
    """Engine whose points are at `place`; images are (K, 1, 1, 1) and not read.

    A look finds each point within a pixel, in x and y, of the whole pixel nearest to its expected position. Towards a
    point further away, but within half a ridge period, it moves by up to 1.5 px in each of `ROUNDS` rounds.

    Args:
        place: (N, 2) px, for all frames until it is replaced.
        by_neighbours: returns the positions (N, 2) px that neighbours expect, from those of the points that are found.
        search_px: reach of a search, px.

    Attributes:
        searches, looks: number of points of each search and look.
    """

    name = described = "known"
    cell_px = 4

    def __init__(self, place: Array, by_neighbours: Callable[[Array], Array] | None = None, search_px: int = 8) -> None:
        self.settings = EngineSettings(search_px=search_px)
        self.place, self._by_neighbours = place, by_neighbours
        self.searches: list[int] = []
        self.looks: list[int] = []
        self._warp = np.broadcast_to(np.eye(2, dtype=np.float32), (len(place), 2, 2))
        self._pattern = np.random.default_rng(1).standard_normal((len(place), 81)).astype(np.float32)

    def noise(self, image: Array) -> float:
        return 0.0

    def key(self, image: Array) -> KeyFrame:
        return KeyFrame(image, 0.0)

    def prepare(self, key: KeyFrame, points: Array, warp: Array | None = None) -> Templates:
        return Templates(len(points))

    def follow(
        self, templates: Templates, images: Array, place: Array, speed: Array, rows: Array | None = None
    ) -> Followed:
        there = self.place if rows is None else self.place[rows]
        self.looks.append(len(there))
        near = (place + speed).astype(np.float32)
        for _ in range(ROUNDS):
            whole = np.round(near)
            off = there - whole
            found = (np.abs(off) <= REACH).all(-1)
            leads = (np.abs(off) <= _HALF_A_RIDGE).all(-1) & ~found
            near = np.where(leads[:, None], whole + np.clip(off, -_STEP, _STEP), near)
        nothing = np.where(found, 0, np.nan).astype(np.float32)
        points = (there + nothing[:, None]).astype(np.float32)
        covariance = 1e-4 * np.eye(2, dtype=np.float32) + nothing[:, None, None]
        status = np.where(found, TrackStatus.TRACKED, TrackStatus.NOT_CONVERGED).astype(np.uint8)
        one = FoundPoints(points, nothing, covariance, status, np.where(found[:, None], there, near).astype(np.float32))
        return Followed(FoundPoints(*(each[None] for each in one)), one.estimate, speed)

    def correct(self, start: Array, found: FoundPoints, numbers: Array, inverse_warp: Array) -> Corrected:
        points = found.points[0]
        expected = self._by_neighbours(points) if self._by_neighbours else np.full_like(points, np.nan)
        still = np.zeros((1, len(points)), np.float32)
        return Corrected(found, self._warp[None], still, expected[None].astype(np.float32))

    def neighbours(self, start: Array) -> None:
        return None

    def outliers(self, neighbours: None, start: Array, found: FoundPoints) -> tuple[Array, Array]:
        nobody = np.zeros(found.status.shape, bool)
        return nobody, nobody

    def search(self, key: KeyFrame, image: Array, points: Array, guess: Array) -> tuple[Array, Array]:
        """Return positions 0.7 px beside the points within reach of a search, and the guesses of all others; and which
        are within reach.
        """
        self.searches.append(len(points))
        rows = [int(np.flatnonzero((self.start == point).all(1))[0]) for point in points]
        there = self.place[rows]
        near = (np.abs(there - guess) <= self.settings.search_px).all(1)
        return np.where(near[:, None], there + np.float32(0.7), guess).astype(np.float32), near

    def windows(self, images: Array, number: Array, places: Array, warp: Array, step: int) -> Array:
        return self._pattern[: len(places)]

    start: Array  # (N, 2) px of the points in their key frame: set by the test
