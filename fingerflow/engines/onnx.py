"""Engine that runs exported graphs, such as those of a deployment bundle."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

import numpy as np

from fingerflow.engines.engine import (
    ROWS,
    STEP,
    Array,
    Corrected,
    EngineSettings,
    EnteredPoints,
    Followed,
    FrameContact,
    FrameEllipse,
    FrameFields,
    GlassLight,
    Images,
    Recent,
    TrackedPoints,
    reject_outliers,
    select,
)
from fingerflow.engines.prediction import MotionState
from fingerflow.errors import FingerflowError
from fingerflow.kernels.contact_sizes import cell_of
from fingerflow.kernels.tracking import find_neighbours
from fingerflow.kernels.tracking_limits import ROUNDS, WARP_GAUGE_PX, TrackStatus

_TEMPLATES = tuple(f"template_{name}" for name in ("start", "samples", "numbers"))
_LEAST_POINTS = 256  # smallest number of points of a graph that is exported for the points at hand


class _KeyFrame:
    """Image of a key frame (1, 1, H, W), and its noise; its spline is computed at the first template update."""

    def __init__(self, view: Array, noise: float) -> None:
        self.view, self.noise, self.spline = view, noise, None


class _OnnxTemplates:
    """Templates of n points, stored as arrays and, for fast calls, as prepared inputs of the ONNX graph `track`."""

    def __init__(self, arrays: dict[str, Array], key: _KeyFrame, track: Any) -> None:
        self.arrays, self.key, self.noise, self._track = arrays, key, key.noise, track
        self._count = arrays["template_start"].shape[1] if arrays else 0
        self._values: dict[str, Any] = {}
        self._lock = threading.Lock()

    @property
    def numbers(self) -> Array:
        """Return the template statistics (n, 32) in the order of `kernels.tracking_limits.Number`."""
        return self.arrays["template_numbers"][0, : self._count]

    def kept(self, points: int) -> dict[str, Any]:
        """Return the templates, padded to `points`, as graph inputs kept in the memory of the execution provider."""
        with self._lock:
            if not self._values:
                self.arrays = {name: filled(array, points, axis=1) for name, array in self.arrays.items()}
                self._values = {name: self._track.kept(name, array) for name, array in self.arrays.items()}
            return self._values

    def update(self, rows: Array, updated: _OnnxTemplates) -> None:
        """Replace the templates with indices `rows` by `updated`, also in the memory of the execution provider."""
        for name, array in self.arrays.items():
            array[:, rows] = updated.arrays[name][:, : len(rows)]
        if not self._track.shares_memory:
            for name in self._values:
                self._values[name] = self._track.kept(name, self.arrays[name])


class OnnxEngine:
    """Engine that runs graphs by sessions of ONNX Runtime; it implements `engine.Engine`.

    Args:
        sessions: of the graphs, by name, with the interface of `sessions.GraphSession`.
        settings: with which the graphs were exported.
        points: number of points for which they were exported, to which inputs are padded; None pads them to a power of
            two, for sessions that take any number.
        described: name with the provider.
    """

    name = "onnx"

    def __init__(
        self,
        sessions: Mapping[Any, Any],
        settings: EngineSettings,
        points: int | None = None,
        described: str = "onnx (CPUExecutionProvider)",
    ) -> None:
        self.settings, self.described = settings, described
        self._sessions, self._points = sessions, points
        self.cell_px = settings.cell_px or cell_of(settings.gross_radius_px)
        self._light, self._support = Recent(self._kept_light), Recent(self._computed_support)
        self._neighbours = Recent(self._found_neighbours)

    def images(self, frames: Array) -> Array:
        images: Array = np.ascontiguousarray(frames)[:, None]
        return images

    def _room(self, count: int) -> int:
        """Return the number of points to which the inputs of a graph of `count` points are padded."""
        return self._points or max(_LEAST_POINTS, 1 << (count - 1).bit_length())

    def contact(self, images: Images, light: GlassLight, threshold: Array | None = None) -> FrameContact:
        views = {"contact_view": images, **self._light(light)}
        if threshold is None:
            threshold = self._sessions["threshold"](views)["threshold"]
        outputs = self._sessions["contact"]({**views, "threshold": threshold}) | {"threshold": threshold}
        return FrameContact(**{name: outputs.get(name) for name in FrameContact._fields})

    def _kept_light(self, light: GlassLight) -> dict[str, Any]:
        contact = self._sessions["contact"]
        return {name: contact.kept(name, array) for name, array in light._asdict().items()}

    def detect(self, image: Images, mask: Array, count: int) -> Array:
        if count != self._points:
            raise ValueError(f"{count} points are to be seeded: the bundle was exported for {self._points}")
        points = self._sessions["detect"]({"topography_view": image, "mask": mask[None, None]})["points"][0]
        found: Array = points[np.isfinite(points).all(1)]
        return found

    def prepare(self, key: Images | _OnnxTemplates, points: Array, warp: Array | None = None) -> _OnnxTemplates:
        if isinstance(key, _OnnxTemplates):
            frame = key.key
        else:
            frame = _KeyFrame(key.copy(), float(self._sessions["noise"]({"topography_view": key})["noise"][0]))
        track, noise = self._sessions["track"], np.array([frame.noise], np.float32)
        if not len(points):
            return _OnnxTemplates({}, frame, track)
        if warp is None:
            inputs = {"topography_view": frame.view, "noise": noise, **self._pad_points(points=points[None])}
            outputs = self._sessions["prepare"](inputs)
            return _OnnxTemplates({name: outputs[name][:, : len(points)] for name in _TEMPLATES}, frame, track)
        if frame.spline is None:
            spline = self._sessions["spline"]({"topography_view": frame.view})["spline"]
            frame.spline = self._sessions["renew"].kept("spline", spline)
        shared = {"spline": frame.spline, "noise": noise}
        arrays = self._in_pieces("renew", {"points": points[None], "warp": warp[None]}, shared)
        return _OnnxTemplates(arrays, frame, track)

    def track(
        self, templates: _OnnxTemplates, images: Images, place: Array, speed: Array, rows: Array | None = None
    ) -> Followed:
        course, frames = MotionState.begin(place, speed), []
        every = np.arange(len(place)) if rows is None else rows
        for k in range(len(images)):
            image = images[k : k + 1]
            found = self._track_frame(templates, image, course.expect(), every, whole=rows is None)
            for _ in range(ROUNDS - 1):
                lost = np.flatnonzero(found.status[0] == TrackStatus.NOT_CONVERGED)
                if not len(lost):
                    break
                again = self._track_frame(templates, image, found.estimate[0, lost], every[lost])
                for whole, part in zip(found, again, strict=True):
                    whole[:, lost] = part
            course = course.see(found)
            frames.append(found)
        joined = found if len(frames) == 1 else TrackedPoints(*map(np.concatenate, zip(*frames, strict=True)))
        return Followed(joined, course.place, course.speed)

    def _track_frame(
        self, templates: _OnnxTemplates, images: Images, guess: Array, rows: Array, whole: bool = False
    ) -> TrackedPoints:
        """Track the templates with indices `rows` (L,) in a frame from guessed positions (L, 2) px: all in one run of
        the ONNX graph if they are many or `whole` is true, else a few at a time.
        """
        points = self._room(len(templates.numbers))
        if whole or 2 * len(rows) > points:
            near = np.full((1, points, 2), np.nan, np.float32)
            near[0, rows] = guess
            given = {
                **templates.kept(points),
                "topography_view": images,
                "prediction": near,
            }
            found = self._sessions["track"](given)
            return select(TrackedPoints(**found), slice(None), slice(0, len(rows)) if whole else rows)
        held = {name: array[:, rows] for name, array in templates.arrays.items()}
        return TrackedPoints(
            **self._in_pieces("track_few", {**held, "prediction": guess[None]}, {"topography_view": images})
        )

    def correct(self, start: Array, found: TrackedPoints, numbers: Array, inverse_warp: Array) -> Corrected:
        count = len(start)
        if count > 1:  # a single point has no neighbour
            inputs = self._pad_points(start=start[None], found=found.points, position_std=np.sqrt(found.variance))
            masks = self._sessions["outliers"]({**self._neighbours(start), **inputs})
            found = reject_outliers(found, masks["off_neighbours"][:, :count], masks["uncertain"][:, :count])
        given = self._pad_points(
            start=start[None],
            found=found.points,
            found_covariance=found.covariance,
            template_numbers=numbers[None],
            inverse_warp=inverse_warp[None],
        )
        got = self._sessions["correct"]({**given, **self._support(start)})
        points, covariance, *others = (one[:, :count] for one in got.values())
        return Corrected(found._replace(points=points, covariance=covariance), *others)

    def _computed_support(self, start: Array) -> dict[str, Any]:
        """Return the inputs of the graph `correct` that depend only on the key-frame positions (N, 2) of the points:
        the neighbours of each.
        """
        outputs = self._sessions["support"](self._pad_points(start=start[None]))
        return {name: self._sessions["correct"].kept(name, array) for name, array in outputs.items()}

    def _found_neighbours(self, start: Array) -> dict[str, Array]:
        """Return the inputs of the graph `outliers` that depend only on the positions (N, 2) in the key frame."""
        points = self._room(len(start))
        number, x, y, within = (
            array[None, :, :points] for array in find_neighbours(filled(start, points), WARP_GAUGE_PX)
        )
        return {
            "neighbour_number": number,
            "neighbour_offset": np.stack((x, y), axis=-1),
            "neighbour_within": within,
        }

    def search(self, templates: _OnnxTemplates, image: Images, points: Array, guess: Array) -> tuple[Array, Array]:
        views = {"key_view": templates.key.view, "topography_view": image}
        found = self._in_pieces("search", {"points": points[None], "prediction": guess[None]}, views)
        return found["places"][0], found["returns"][0]

    def windows(self, images: Images, number: Array, places: Array, warp: Array, step: int) -> Array:
        if step != STEP:
            raise ValueError(f"a grid of {step} px: graphs are exported for {STEP}")
        samples = (2 * (self.settings.window_px // 2) // step + 1) ** 2
        result = np.empty((len(places), samples), np.float32)
        for frame in np.unique(number):
            some = number == frame
            given = {"points": places[None, some], "warp": warp[None, some]}
            image = {"topography_view": images[frame : frame + 1]}
            result[some] = self._in_pieces("windows", given, image)["samples"][0]
        return result

    def fit(
        self, points: Array, values: Array, queries: Array, gauge: float, variance: Array | None = None
    ) -> tuple[Array, Array | None]:
        noise = np.zeros(values.shape[:2], np.float32) if variance is None else variance
        inputs = self._pad_points(reference=points[None], displacement=values, variance=noise, queries=queries[None])
        outputs = self._sessions["fit"]({**inputs, "gauge_length": np.array([gauge], np.float32)})
        gradient, covariance = (outputs[name][:, : len(queries)] for name in ("gradient", "covariance"))
        return gradient, None if variance is None else covariance

    def fields(
        self,
        reference: Array,
        displacement: Array,
        ellipse: FrameEllipse,
        covariance: Array | None = None,
        entered: EnteredPoints | None = None,
    ) -> FrameFields:
        count = len(reference)
        exact = np.zeros((*displacement.shape, 2), np.float32) if covariance is None else covariance
        of_points = {"reference": reference[None], "displacement": displacement, "covariance": exact}
        if entered is not None:
            spread = entered.covariance
            if spread is None:
                spread = np.zeros((*entered.gradient.shape, 2, 2), np.float32)
            of_points |= {"among": entered.among, "gradient": entered.gradient, "gradient_covariance": spread}
        inputs = self._pad_points(**of_points)
        inputs |= {f"ellipse_{name}": values for name, values in ellipse._asdict().items()}
        outputs = self._sessions["fields" if entered is None else "fields_entered"](inputs)
        of_frame = ("median", "median_std", "known_share")
        fields = {name: values if name in of_frame else values[:, :count] for name, values in outputs.items()}
        if covariance is None:
            fields |= dict.fromkeys(("divergence_std", "curl_std", "median_std"))
        return FrameFields(**fields)

    def _in_pieces(self, name: str, of_points: dict[str, Array], shared: dict[str, Any]) -> dict[str, Array]:
        """Run a graph of fixed size on a few points at a time, and return the concatenated outputs (1, n, ...).

        `of_points` (1, n, ...) is cut to what the graph takes and padded; `shared` is the same in each call.
        """
        session, count = self._sessions[name], next(iter(of_points.values())).shape[1]
        parts = []
        for first in range(0, max(count, 1), ROWS):
            some = {key: array[:, first : first + ROWS] for key, array in of_points.items()}
            parts.append(session({**shared, **{key: filled(one, ROWS, axis=1) for key, one in some.items()}}))
        return {key: np.concatenate([part[key] for part in parts], axis=1)[:, :count] for key in parts[0]}

    def _pad_points(self, **given: Array) -> dict[str, Array]:
        """Pad arrays (1, n, ...) to the points for which the graphs are exported, with NaN, or 0 for integers."""
        return {name: filled(array, self._room(array.shape[1]), axis=1) for name, array in given.items()}


def filled(array: Array, points: int, axis: int = 0) -> Array:
    """Pad an array to `points` entries along an axis, with NaN for floating point, else 0.

    Raises FingerflowError if it has more.
    """
    missing = points - array.shape[axis]
    if not missing:
        return array
    if missing < 0:
        raise FingerflowError(
            f"{array.shape[axis]} points are given, the bundle was exported for {points}; export it again"
        )
    shape = list(array.shape)
    shape[axis] = missing
    nothing = np.nan if array.dtype.kind == "f" else 0
    return np.concatenate((array, np.full(shape, nothing, array.dtype)), axis=axis)
