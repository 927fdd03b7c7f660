"""An engine that knows where points are: what the tracker decides is tested by it, and not what is computed."""

from collections.abc import Callable
from typing import Any

import numpy as np

from fingerflow.engines.engine import Corrected, EngineSettings, Followed, FoundPoints, KeyFrame
from fingerflow.kernels.tracking_limits import NUMBERS, REACH, ROUNDS, TrackStatus

Array = np.ndarray[Any, Any]
_HALF_A_RIDGE = 5.0  # px, within which a look leads to a point
_STEP = 1.5  # px, at most


class Templates:
    """Numbers of N points."""

    def __init__(self, count: int) -> None:
        self.numbers = np.zeros((count, NUMBERS), np.float32)


class KnownSkin:
    """Points are where `place` says; images are (K, 1, 1, 1), and not looked at.

    Each point is found within a pixel, in x and y, of the whole pixel nearest to where it is expected; one that is not
    leads up to 1.5 px on, five times, if it lies within half a ridge's period.

    Args:
        place: (N, 2) px, for all frames until it is replaced.
        by_neighbours: (N, 2) px where neighbours expect points, from those that are found.

    Attributes:
        searches, looks: rows that were asked for, call after call.
        warp: (N, 2, 2) of the skin.
        updates: rows of templates that were updated.
    """

    name = described = "known"
    cell_px = 4

    def __init__(self, place: Array, by_neighbours: Callable[[Array], Array] | None = None, search_px: int = 8) -> None:
        self.settings = EngineSettings(search_px=search_px)
        self.place, self._by_neighbours = place, by_neighbours
        self.searches: list[int] = []
        self.looks: list[int] = []
        self.prepared: list[int] = []
        self.updates: list[Array] = []
        self.warp = np.broadcast_to(np.eye(2, dtype=np.float32), (len(place), 2, 2))
        self.inverse = self.warp  # of templates, as `correct` was told last
        self._pattern = np.random.default_rng(1).standard_normal((len(place), 81)).astype(np.float32)

    def noise(self, image: Array) -> float:
        return 0.0

    def key(self, image: Array) -> KeyFrame:
        return KeyFrame(image, 0.0)

    def prepare(self, key: KeyFrame, points: Array, warp: Array | None = None) -> Templates:
        if warp is not None:
            self.prepared.append(len(points))
        return Templates(len(points))

    def update(self, templates: Templates, rows: Array, updated: Templates) -> None:
        self.updates.append(rows)

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
        self.inverse = inverse_warp
        points = found.points[0]
        expected = self._by_neighbours(points) if self._by_neighbours else np.full_like(points, np.nan)
        left = np.square(self.warp @ inverse_warp - np.eye(2)).sum((-2, -1)) ** 0.5
        shift = (self.settings.window_px // 2 * left).astype(np.float32)
        return Corrected(found, self.warp[None], shift[None], expected[None].astype(np.float32))

    def neighbours(self, start: Array) -> None:
        return None

    def outliers(self, neighbours: None, start: Array, found: FoundPoints) -> tuple[Array, Array]:
        nobody = np.zeros(found.status.shape, bool)
        return nobody, nobody

    def search(self, key: KeyFrame, image: Array, points: Array, guess: Array) -> tuple[Array, Array]:
        """Places within the reach of a search, to 0.7 px; others are not moved."""
        self.searches.append(len(points))
        rows = [int(np.flatnonzero((self.start == point).all(1))[0]) for point in points]
        there = self.place[rows]
        near = (np.abs(there - guess) <= self.settings.search_px).all(1)
        return np.where(near[:, None], there + np.float32(0.7), guess).astype(np.float32), near

    def windows(self, images: Array, number: Array, places: Array, warp: Array, step: int) -> Array:
        return self._pattern[: len(places)]

    start: Array  # (N, 2) px of the points in their key frame: set by the test
