"""Engine that runs graphs: those of a deployment bundle in ONNX Runtime, or the same torch modules in torch."""

import threading
from collections.abc import Mapping
from typing import Any

import numpy as np

from fingerflow.engines.engine import (
    ANY_NUMBER,
    ROWS,
    TRACKED,
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
from fingerflow.errors import FingerflowError
from fingerflow.kernels.contact_sizes import cell_of
from fingerflow.kernels.tracking import find_neighbours
from fingerflow.kernels.tracking_limits import ROUNDS, SPEED_FRAMES, SPEED_WEIGHT, WARP_GAUGE_PX, TrackStatus

_TEMPLATES = tuple(f"template_{name}" for name in ("start", "samples", "numbers"))
_LEAST_POINTS = 256  # smallest number of points of a graph that is exported for the points at hand
_STEP = 32  # points; ONNX Runtime plans its memory once for each size


class _KeyFrame:
    """Image of a key frame (1, 1, H, W), and its noise; its spline is computed at the first template update."""

    def __init__(self, view: Images, noise: float) -> None:
        self.view, self.noise, self.spline = view, noise, None


class _GraphTemplates:
    """Templates of n points, stored as arrays and, for fast calls, as prepared inputs of the graph `track`."""

    def __init__(self, arrays: dict[str, Array], key: _KeyFrame, track: Any) -> None:
        self.arrays, self.key, self.noise, self._track = arrays, key, key.noise, track
        self._count = arrays["template_start"].shape[1] if arrays else 0
        self._inputs: dict[str, Any] = {}
        self._lock = threading.Lock()

    @property
    def numbers(self) -> Array:
        """Return the template statistics (n, 32) in the order of `kernels.tracking_limits.Number`."""
        return self.arrays["template_numbers"][0, : self._count]

    def inputs(self, points: int) -> dict[str, Any]:
        """Return the templates, padded to `points`, as inputs in the memory in which the graph runs."""
        with self._lock:
            if not self._inputs:
                self.arrays = {name: padded(array, points) for name, array in self.arrays.items()}
                self._inputs = {name: self._track.kept(name, array) for name, array in self.arrays.items()}
            return self._inputs

    def update(self, rows: Array, updated: "_GraphTemplates") -> None:
        """Replace the templates with indices `rows` by `updated`, also in the memory in which the graph runs."""
        for name, array in self.arrays.items():
            array[:, rows] = updated.arrays[name][:, : len(rows)]
        for name, value in self._inputs.items():
            self._inputs[name] = self._track.updated(name, value, self.arrays[name], rows)


class GraphEngine:
    """Engine that runs graphs by sessions; it implements `engine.Engine`.

    Args:
        sessions: of the graphs, by name, with the interface of `sessions.GraphSession`.
        settings: with which the graphs were built.
        points: number of points for which they were exported, to which inputs are padded, but for graphs that take any
            number; None pads them to a power of two, for sessions that take any number.
        described: name of the engine, with the provider or the device.
    """

    #: Graphs have fixed shapes: arrays of points are padded, and a graph takes `ROWS` of a few points.
    fixed = True

    def __init__(
        self,
        sessions: Mapping[Any, Any],
        settings: EngineSettings,
        points: int | None = None,
        described: str = "onnx (CPUExecutionProvider)",
    ) -> None:
        self.settings, self.described, self.name = settings, described, described.partition(" ")[0]
        self._sessions, self._points = sessions, points
        self._any_number = bool(points) and sessions["fit"].any_number
        self.cell_px = settings.cell_px or cell_of(settings.gross_radius_px)
        self._light, self._support = Recent(self._light_inputs), Recent(self._support_inputs)
        self._neighbours = Recent(self._neighbour_inputs)

    def images(self, frames: Array) -> Images:
        return np.ascontiguousarray(frames)[:, None]

    def contact(self, images: Images, light: GlassLight, threshold: Array | None = None) -> FrameContact:
        views = {"contact_view": images, **self._light(light)}
        if threshold is None:
            threshold = self._sessions["threshold"](views)["threshold"]
        outputs = self._sessions["contact"]({**views, "threshold": threshold}) | {"threshold": threshold}
        return FrameContact(**{name: outputs.get(name) for name in FrameContact._fields})

    def _light_inputs(self, light: GlassLight) -> dict[str, Any]:
        contact = self._sessions["contact"]
        return {name: contact.kept(name, array) for name, array in zip(("light", "black"), light, strict=True)}

    def detect(self, image: Images, mask: Array, count: int) -> Array:
        if count != self._points:
            raise ValueError(f"{count} points are to be seeded: the bundle was exported for {self._points}")
        points: Array = self._sessions["detect"]({"topography_view": image, "mask": mask[None, None]})["points"][0]
        return points[np.isfinite(points).all(1)]

    def prepare(self, key: Images | _GraphTemplates, points: Array, warp: Array | None = None) -> _GraphTemplates:
        if isinstance(key, _GraphTemplates):
            frame = key.key
        else:
            image = key.copy() if isinstance(key, np.ndarray) else key.clone()
            frame = _KeyFrame(image, float(self._sessions["noise"]({"topography_view": image})["noise"][0]))
        track, noise = self._sessions["track"], np.array([frame.noise], np.float32)
        if not len(points):
            return _GraphTemplates({}, frame, track)
        if warp is None:
            inputs = {"topography_view": frame.view, "noise": noise, **self._pad_points(points=points[None])}
            outputs = self._sessions["prepare"](inputs)
            return _GraphTemplates({name: outputs[name][:, : len(points)] for name in _TEMPLATES}, frame, track)
        if frame.spline is None:
            spline = self._sessions["spline"]({"topography_view": frame.view})["spline"]
            frame.spline = self._sessions["renew"].kept("spline", spline)
        of_points, shared = {"points": points[None], "warp": warp[None]}, {"spline": frame.spline, "noise": noise}
        return _GraphTemplates(self._in_pieces("renew", of_points, shared), frame, track)

    def track(
        self, templates: _GraphTemplates, images: Images, place: Array, speed: Array, rows: Array | None = None
    ) -> Followed:
        seen, frames = np.ones(len(place), bool), []
        chosen = np.arange(len(place)) if rows is None else rows
        for k in range(len(images)):
            image, guess = images[k : k + 1], (place + speed).astype(np.float32)
            found = self._track_frame(templates, image, guess, chosen, whole=rows is None)
            for _ in range(ROUNDS - 1):
                lost = np.flatnonzero(found.status[0] == TrackStatus.NOT_CONVERGED)
                if not len(lost):
                    break
                again = self._track_frame(templates, image, found.estimate[0, lost], chosen[lost])
                for whole, part in zip(found, again, strict=True):
                    whole[:, lost] = part
            # The prediction of `tracker.point_prediction`. A point that is found again may lie beside its prediction;
            # this difference is no motion and leaves its speed unchanged.
            tracked = found.status[0] == TRACKED
            missed = np.where((tracked & seen)[:, None], found.estimate[0] - guess, np.float32(0))
            lasting = np.where(tracked, np.float32(1), np.float32(1 - 1 / SPEED_FRAMES))[:, None]
            place, seen = np.where(tracked[:, None], found.estimate[0], guess), tracked
            speed = (speed * lasting + np.float32(SPEED_WEIGHT) * missed).astype(np.float32)
            frames.append(found)
        joined = found if len(frames) == 1 else TrackedPoints(*map(np.concatenate, zip(*frames, strict=True)))
        return Followed(joined, place, speed)

    def _track_frame(
        self, templates: _GraphTemplates, images: Images, guess: Array, rows: Array, whole: bool = False
    ) -> TrackedPoints:
        """Track the templates with indices `rows` (L,) in a frame from guessed positions (L, 2) px: all in one run of
        the graph if `whole` is true or they are many for a graph of fixed shapes, else a few at a time.
        """
        points = self._size(len(templates.numbers))
        if whole or (self.fixed and 2 * len(rows) > points):
            near = np.full((1, points, 2), np.nan, np.float32)
            near[0, rows] = guess
            inputs = {**templates.inputs(points), "topography_view": images, "prediction": near}
            outputs = self._sessions["track"](inputs)
            return select(TrackedPoints(**outputs), slice(None), slice(0, len(rows)) if whole else rows)
        arrays = {name: array[:, rows] for name, array in templates.arrays.items()} | {"prediction": guess[None]}
        return TrackedPoints(**self._in_pieces("track_few", arrays, {"topography_view": images}))

    def correct(self, start: Array, found: TrackedPoints, numbers: Array, inverse_warp: Array) -> Corrected:
        count = len(start)
        if count > 1:  # a single point has no neighbour
            inputs = self._pad_points(start=start[None], found=found.points, position_std=np.sqrt(found.variance))
            masks = self._sessions["outliers"]({**self._neighbours(start), **inputs})
            found = reject_outliers(found, masks["off_neighbours"][:, :count], masks["uncertain"][:, :count])
        tracked = {"start": start[None], "found": found.points, "found_covariance": found.covariance}
        templates = {"template_numbers": numbers[None], "inverse_warp": inverse_warp[None]}
        outputs = self._sessions["correct"]({**self._pad_points(**tracked, **templates), **self._support(start)})
        points, covariance, *others = (values[:, :count] for values in outputs.values())
        return Corrected(found._replace(points=points, covariance=covariance), *others)

    def _support_inputs(self, start: Array) -> dict[str, Any]:
        """Return the inputs of the graph `correct` that depend only on the key-frame positions (N, 2) of the points:
        the neighbours of each.
        """
        outputs = self._sessions["support"](self._pad_points(start=start[None]))
        return {name: self._sessions["correct"].kept(name, array) for name, array in outputs.items()}

    def _neighbour_inputs(self, start: Array) -> dict[str, Any]:
        """Return the inputs of the graph `outliers` that depend only on the positions (N, 2) in the key frame."""
        points, outliers = self._size(len(start)), self._sessions["outliers"]
        number, x, y, within = (
            array[None, :, :points] for array in find_neighbours(padded(start[None], points)[0], WARP_GAUGE_PX)
        )
        parts = {"number": number, "offset": np.stack((x, y), axis=-1), "within": within}
        return {f"neighbour_{name}": outliers.kept(f"neighbour_{name}", part) for name, part in parts.items()}

    def search(self, templates: _GraphTemplates, image: Images, points: Array, guess: Array) -> tuple[Array, Array]:
        views = {"key_view": templates.key.view, "topography_view": image}
        outputs = self._in_pieces("search", {"points": points[None], "prediction": guess[None]}, views)
        return outputs["places"][0], outputs["returns"][0]

    def windows(self, images: Images, number: Array, places: Array, warp: Array) -> Array:
        frames = np.unique(number) if len(number) else np.zeros(1, int)
        parts = [np.flatnonzero(number == frame) for frame in frames]
        samples = []
        for frame, part in zip(frames, parts, strict=True):
            of_points, image = {"points": places[None, part], "warp": warp[None, part]}, images[frame : frame + 1]
            samples.append(self._in_pieces("windows", of_points, {"topography_view": image})["samples"][0])
        return np.concatenate(samples)[np.concatenate(parts).argsort()]

    def fit(
        self, points: Array, values: Array, queries: Array, gauge: float, variance: Array | None = None
    ) -> tuple[Array, Array | None]:
        noise = np.zeros(values.shape[:2], np.float32) if variance is None else variance
        inputs = self._pad_points(self._known(values), reference=points[None], displacement=values, variance=noise)
        inputs |= self._pad_points(slice(None), queries=queries[None])
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
        known = self._known(displacement)
        rows = np.where(known, known.cumsum() - 1, -1)  # of unknown points the last row, which is padding

        def spread(values: Array, given: Array | None) -> Array | None:
            """Return a covariance; 0 in place of None where graphs have fixed shapes, which leave out no input."""
            return np.zeros((*values.shape, *values.shape[2:]), np.float32) if given is None and self.fixed else given

        arrays: dict[str, Array | None] = {"reference": reference[None], "displacement": displacement}
        arrays["covariance"] = spread(displacement, covariance)
        if entered is not None:
            arrays |= {"among": entered.among, "gradient": entered.gradient}
            arrays["gradient_covariance"] = spread(entered.gradient, entered.covariance)
        inputs = self._pad_points(known, **arrays) | {f"ellipse_{key}": part for key, part in ellipse._asdict().items()}
        outputs = self._sessions["fields" if entered is None else "fields_entered"](inputs)
        for name in ("divergence", "curl", "strain", "shear", "divergence_std", "curl_std"):
            outputs[name] = None if name.endswith("std") and covariance is None else outputs[name][:, rows]
        return FrameFields(**outputs | ({"median_std": None} if covariance is None else {}))

    def _known(self, values: Array) -> Array:
        """Return a mask (N,) of the points that the graphs of a bundle need: those with values (1, N, C)."""
        return np.isfinite(values[0]).all(1) if self._points else np.ones(values.shape[1], bool)

    def _in_pieces(self, name: str, of_points: dict[str, Array], shared: dict[str, Any]) -> dict[str, Array]:
        """Run a graph on a few points, and return the outputs (1, n, ...): one of fixed size on `ROWS` at a time.

        `of_points` (1, n, ...) is cut to what the graph takes and padded; `shared` is the same in each call.
        """
        session, count = self._sessions[name], next(iter(of_points.values())).shape[1]
        if not self.fixed:
            return session({**shared, **of_points})
        size = self._size(count, True) if self._any_number and name in ANY_NUMBER else ROWS
        pieces = []
        for first in range(0, max(count, 1), size):
            piece = {key: padded(array[:, first : first + size], size) for key, array in of_points.items()}
            pieces.append(session({**shared, **piece}))
        return {key: np.concatenate([piece[key] for piece in pieces], axis=1)[:, :count] for key in pieces[0]}

    def _size(self, count: int, free: bool = False) -> int:
        """Return the number of points to which `count` points are padded as inputs of a graph. It exceeds `count`
        if the graph takes any number of points (`free`), so that the last row is padding.
        """
        if free and self._any_number:
            return (count // _STEP + 1) * _STEP
        return (self._points or max(_LEAST_POINTS, 1 << (count - 1).bit_length())) if self.fixed else count

    def _pad_points(self, known: Any = None, **arrays: Array | None) -> dict[str, Array | None]:
        """Pad arrays (1, n, ...) to the points of a graph, with NaN, or 0 for integers; those of the points `known`, if
        they are given, to the points of a graph that takes any number.
        """
        for name, array in arrays.items():
            if array is not None:
                part = array if known is None else array[:, known]
                arrays[name] = padded(part, self._size(part.shape[1], known is not None))
        return arrays


def padded(array: Array, points: int) -> Array:
    """Extend an array (1, n, ...) of n points to `points` entries, with NaN, or 0 for integers.

    Raises FingerflowError if it has more.
    """
    missing = points - array.shape[1]
    if not missing:
        return array
    if missing < 0:
        raise FingerflowError(
            f"{array.shape[1]} points are given, the bundle was exported for {points}; export it again"
        )
    nothing = np.nan if array.dtype.kind == "f" else 0
    return np.concatenate((array, np.full((len(array), missing, *array.shape[2:]), nothing, array.dtype)), axis=1)
