"""Define the interface of the engines, with the arrays that are passed to and from them."""

from collections.abc import Callable
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels.result_records import EnteredPoints as EnteredPoints
from fingerflow.kernels.result_records import FrameContact as FrameContact
from fingerflow.kernels.result_records import FrameEllipse as FrameEllipse
from fingerflow.kernels.result_records import FrameFields as FrameFields
from fingerflow.kernels.result_records import TrackedPoints as TrackedPoints
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.schema.scene_tables import STEP as STEP
from fingerflow.schema.scene_tables import EngineSettings as EngineSettings

Array = NDArray[Any]

# Batch size of the graphs that process a subset of the points, and largest number of points that a stream searches for
# in one round of lost-point recovery.
ROWS = 64
# Graphs that take any number of points. Their time falls with it, and only a part of the points is in contact.
ANY_NUMBER = ("track_few", "fields", "fields_entered", "fit")
# As integers: NumPy compares an array with a member of an enumeration by calls of Python.
TRACKED = int(TrackStatus.TRACKED)
_UNCERTAIN, _OFF_NEIGHBOURS = int(TrackStatus.UNCERTAIN), int(TrackStatus.OFF_NEIGHBOURS)
# Light of the empty glass above the black level, 0 where the glass is not lit, and this level, the count without light:
# (1, 1, H, W) float32 each, by `contact_view.glass_light`.
GlassLight = tuple[Array, Array]
Images = Any  # frames (K, 1, H, W) as the engine stores them: they have a length and can be sliced by frame


class TemplateBuffers(Protocol):
    """Templates of N points (image windows that tracking finds again in later frames), in buffers of the engine.

    Attributes:
        noise: standard deviation of the white noise of the key frame, grey levels.
    """

    noise: float

    @property
    def numbers(self) -> Array:
        """Return the template statistics (N, 32) in the order of `kernels.tracking_limits.Number`."""

    def update(self, rows: Array, updated: Any) -> None:
        """Replace the templates with indices `rows` (L,) by templates that `Engine.prepare` has returned."""


class Followed(NamedTuple):
    """Points tracked through K frames, and the positions and speeds of the points after the last frame.

    Positions are (N, 2) px, speeds (N, 2) px a frame.
    """

    found: TrackedPoints
    place: Array
    speed: Array


class Corrected(NamedTuple):
    """Tracked points, corrected for the deformation of the skin.

    Attributes:
        found: with corrected points and covariances.
        warp: (K, N, 2, 2) deformation gradient since the key frame; the identity where it is not known.
        shift: (K, N) px by which the deformation has moved the edge of a window since its template was prepared.
        expected: (K, N, 2) px, position predicted from the neighbours of a point; NaN where too few are known.
    """

    found: TrackedPoints
    warp: Array
    shift: Array
    expected: Array


class Engine(Protocol):
    """Interface that every engine implements: stateless computations on frames.

    The engine creates and reads templates; the caller keeps them. All methods may be called from several threads at
    once. Positions are (x, y) px, float32; pixel centres lie at integers.

    Attributes:
        name: "native", "torch" or "onnx", as results state it.
        described: name with its device or provider, as in "onnx (CPUExecutionProvider)".
        settings: with which it was created.
        cell_px: side of the cells of the apparent contact.
        fixed: True if it computes by graphs of fixed shapes, of which `fit` and `fields` take one frame.
    """

    name: str
    described: str
    settings: EngineSettings
    cell_px: int
    fixed: bool

    def images(self, frames: Array) -> Images:
        """Convert frames (K, H, W) of 8 to 16 bit or floating point to the internal format of the engine.

        They are not copied where this can be avoided, and never written to.
        """

    def contact(self, images: Images, light: GlassLight, threshold: Array | None = None) -> FrameContact:
        """Segment the contact: pixels whose relative intensity loss exceeds `threshold` (K,); none if it is NaN.

        Without a threshold it is measured: the relative intensity loss at the edges of ridges in contact, NaN without
        contact.
        """

    def detect(self, image: Images, mask: Array, count: int) -> Array:
        """Detect up to `count` corners (n, 2) px inside a mask (H, W) bool, strongest first."""

    def prepare(self, key: Any, points: Array, warp: Array | None = None) -> TemplateBuffers:
        """Prepare the templates (image windows to be tracked) of points (N, 2) px in a key frame, deformed by the
        matrices `warp` (N, 2, 2) if given.

        `key` is the image (1, 1, H, W) of the key frame, of which a copy is kept, or templates of the same key frame.
        Points that are NaN match nothing.
        """

    def track(self, templates: Any, images: Images, place: Array, speed: Array, rows: Array | None = None) -> Followed:
        """Track templates through consecutive frames: all templates, or those with indices `rows` (L,).

        Their predicted position in the first frame is `place` + `speed` (N or L, 2), in later ones that of
        `tracker.point_prediction`. A point that one step does not reach is tracked on from where it ended, in up to
        `kernels.tracking_limits.ROUNDS` steps.
        """

    def correct(self, start: Array, found: TrackedPoints, numbers: Array, inverse_warp: Array) -> Corrected:
        """Reject outliers among the tracking results `found`, correct the others for the deformation of the skin since
        the templates were prepared, and return them with that deformation.

        The methods are those of `ops.tracking.outliers` and `ops.tracking.deformation`. `start` (N, 2) px lies in the
        key frame, and is the same array for all its frames; statistics `numbers` (N, 32) and inverse deformation
        (N, 2, 2) are those of the templates.
        """

    def search(self, templates: Any, image: Images, points: Array, guess: Array) -> tuple[Array, Array]:
        """Search `image` for the image content around `points` (n, 2) px of the key frame of templates, near `guess`
        (n, 2) px; return the positions found (n, 2) px and a mask (n,) of those confirmed by a search back.

        A position is confirmed where the backward search returns to the start.
        """

    def windows(self, images: Images, number: Array, places: Array, warp: Array) -> Array:
        """Sample the grey levels (N, m) in windows around positions `places` (N, 2) px, deformed by the matrices `warp`
        (N, 2, 2), on a grid of `STEP` px; `number` (N,) is the frame of each window.
        """

    def fit(
        self, points: Array, values: Array, queries: Array, gauge: float, variance: Array | None = None
    ) -> tuple[Array, Array | None]:
        """Return the gradients (K, Q, C, 2) in x and y, fitted to values (K, N, C), known at points (N, 2), at query
        positions (Q, 2) within the gauge length `gauge`, in float64, as `ops.local_gradients` does, and their
        covariance (K, Q, C, 2, C, 2).

        `variance` (K, N) is that of a component of a value. Without it the covariance is None.
        """

    def fields(
        self,
        reference: Array,
        displacement: Array,
        ellipse: FrameEllipse,
        covariance: Array | None = None,
        entered: EnteredPoints | None = None,
    ) -> FrameFields:
        """Compute divergence, curl and strain at N points in K frames, and their medians over the contact `ellipse`,
        from displacements (K, N, 2) mm of points with reference positions (N, 2) mm.
        """


def noise_of(engine: Engine, image: Images) -> float:
    """Estimate the standard deviation of the white noise of a frame (1, 1, H, W), grey levels."""
    return engine.prepare(image, np.zeros((0, 2), np.float32)).noise


_T = TypeVar("_T")


class Recent(Generic[_T]):
    """Cache of what a function computes of the arrays of its latest `KEPT` calls, known by identity, which must not
    change.
    """

    KEPT = 4

    def __init__(self, compute: Callable[[Any], _T]) -> None:
        self._compute = compute
        self._values: tuple[tuple[Any, _T], ...] = ()

    def __call__(self, array: Any) -> _T:
        """Return the value for an array, computed at its first call."""
        for known, value in self._values:
            if known is array:
                return value
        value = self._compute(array)
        self._values = ((array, value), *self._values)[: self.KEPT]
        return value


def select(points: TrackedPoints, frames: Any, which: Any = slice(None)) -> TrackedPoints:
    """Return the tracking results of selected frames and points; all points by default."""
    return TrackedPoints(*[values[frames][:, which] for values in points])


def reject(points: TrackedPoints, which: Array, status: int) -> TrackedPoints:
    """Return the results with the points marked in `which` (K, N) rejected: their positions and covariances are NaN,
    their status is `status`.
    """
    if not np.logical_or.reduce(which, axis=None):
        return points
    positions, covariance, changed = points.points.copy(), points.covariance.copy(), points.status.copy()
    positions[which] = covariance[which] = np.nan
    changed[which] = status
    return TrackedPoints(positions, points.error, covariance, changed, points.estimate)


def reject_outliers(points: TrackedPoints, off_neighbours: Array, uncertain: Array) -> TrackedPoints:
    """Return the results with the tracked points rejected that two masks (K, N) mark: those that are far more uncertain
    than their neighbours, and those that deviate from them.
    """
    tracked = points.status == TRACKED
    certain = reject(points, tracked & uncertain, _UNCERTAIN)
    return reject(certain, tracked & off_neighbours, _OFF_NEIGHBOURS)
