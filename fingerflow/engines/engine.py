"""The interface of an engine, and the arrays that it takes and gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

# Points per call of the graphs that take a subset of them; also the most that a stream searches for in one frame.
ROWS = 64
Images = Any  # frames (K, 1, H, W) as an engine holds them: they have a length, and slices of frames


@dataclass(frozen=True)
class EngineSettings:
    """What an engine needs to know beside its arrays, as a scene or a recipe has it.

    Attributes:
        median_px, gross_radius_px, cell_px, stride_px: of the contact (`graphs.ContactGraph`).
        window_px, gain_offset, forward_backward_limit_px: of a template and of what is found of it.
        search_px: how far from its prediction a lost point is searched for; 0 for not at all.
        min_distance_px: between points that are seeded.
        gauge_length_mm: of the fields.
        strain: measure of strain, as in `ops.green_lagrange`.
    """

    median_px: int = 3
    gross_radius_px: int = 8
    cell_px: int | None = None
    stride_px: int = 1
    window_px: int = 25
    gain_offset: bool = True
    forward_backward_limit_px: float = 1.0
    search_px: int = 8
    min_distance_px: float = 6.0
    gauge_length_mm: float = 1.6
    strain: str = "green_lagrange"


class GlassLight(NamedTuple):
    """What the empty glass gives each pixel: counts of light and counts without light, as the engine holds them."""

    light: Any
    black: Any


class FrameContact(NamedTuple):
    """Contact of K frames, in px of the contact view; ellipses are NaN without contact.

    Attributes:
        real_contact_mask: (K, 1, H, W) bool, the micro-junctions; None where the engine leaves it out.
        real_area_px, gross_area_px: (K,) px.
        center, semi_axes: (K, 2) px; angle (K,) rad, from x towards y.
        density_margin: (K, 1, h, w) of the apparent contact on cells, as `ops.contact.cells.covered` takes it.
        light_gain: (K,) brightness of the lamp, 1 that of the empty glass; NaN where no glass is seen.
    """

    real_contact_mask: Array | None
    real_area_px: Array
    gross_area_px: Array
    center: Array
    semi_axes: Array
    angle: Array
    density_margin: Array
    light_gain: Array


class KeyFrame(NamedTuple):
    """A key frame as the engine holds it, and the standard deviation of its noise, grey levels."""

    image: Images
    noise: float


class TemplateBuffers(Protocol):
    """Templates of N points, in buffers of the engine."""

    @property
    def numbers(self) -> Array:
        """(N, 32) template statistics (`kernels.tracking_limits.Number`)."""
        ...


class FoundPoints(NamedTuple):
    """Points found in K frames.

    Attributes:
        points: (K, N, 2) px, NaN where the status is not TRACKED.
        error: (K, N) px, forward-backward distance.
        covariance: (K, N, 2, 2) px^2, NaN as the points.
        status: (K, N) uint8 (`kernels.tracking_limits.TrackStatus`).
        estimate: (K, N, 2) px, where to look next.
    """

    points: Array
    error: Array
    covariance: Array
    status: Array
    estimate: Array

    @property
    def variance(self) -> Array:
        """(K, N) px^2, mean of both components."""
        return (self.covariance[..., 0, 0] + self.covariance[..., 1, 1]) / 2

    def of(self, frames: Any, points: Any = slice(None)) -> FoundPoints:
        """Some frames, or all frames and some points."""
        return FoundPoints(*(one[frames][:, points] for one in self))


class Followed(NamedTuple):
    """What was found in K frames, and place and speed (N, 2) px of the points after the last one."""

    found: FoundPoints
    place: Array
    speed: Array


class Corrected(NamedTuple):
    """What was found, corrected for the deformation of the skin.

    Attributes:
        found: with corrected points and covariances.
        warp: (K, N, 2, 2) deformation gradient since the key frame; the identity where it is not known.
        shift: (K, N) px by which the edge of a window has moved since its template was prepared.
        expected: (K, N, 2) px, where the neighbours of a point expect it; NaN where too few are known.
    """

    found: FoundPoints
    warp: Array
    shift: Array
    expected: Array


class FrameEllipse(NamedTuple):
    """Apparent contact of K frames in mm: center (K, 2), semi_axes (K, 2), angle (K,) rad."""

    center: Array
    semi_axes: Array
    angle: Array


class EnteredPoints(NamedTuple):
    """Points that were advected into the contact (`tracker.entry`), with the gradient since their own entry.

    Attributes:
        among: (K, N) bool.
        gradient: (K, N, 2, 2), NaN where it is not known.
        covariance: (K, N, 2, 2, 2, 2), or None.
    """

    among: Array
    gradient: Array
    covariance: Array | None


class Fit(NamedTuple):
    """Gradients (K, Q, C, 2) of values at queries, and their covariance (K, Q, C, 2, C, 2) if variances are given."""

    gradient: Array
    covariance: Array | None


class FrameFields(NamedTuple):
    """Fields at N points of K frames and medians over the apparent contact, as `graphs.fields.Fields` has them."""

    divergence: Array
    curl: Array
    strain: Array
    shear: Array
    divergence_std: Array | None
    curl_std: Array | None
    median: Array
    median_std: Array | None
    known_share: Array


@runtime_checkable
class Engine(Protocol):
    """Computes frames and holds no history: templates and key frames are the caller's, made and read by the engine.

    Calls from several threads at once are allowed, but for `update`. Positions are (x, y) px with integer pixel
    centres, float32.

    Attributes:
        name: "native", "torch" or "onnx".
        described: the name, and what there is to say of it: "onnx (CPUExecutionProvider)".
        settings: with which it was made.
        cell_px: side of the cells of the apparent contact.
    """

    name: str
    described: str
    settings: EngineSettings
    cell_px: int

    def images(self, frames: Array) -> Images:
        """Frames (K, H, W) of a view, of 8 to 16 bit or floating point, as the engine holds them; without a copy where
        it can. They are not written to.
        """
        ...

    def light(self, empty: Array, dark: Array | None, inside: Array | None = None) -> GlassLight:
        """`ops.glass_light` of the empty glass (H, W) and of the view without light, counts; no light, so that nothing
        touches, where a mask (H, W) bool is False.
        """
        ...

    def contact(self, images: Images, light: GlassLight, threshold: Array) -> FrameContact:
        """Contact by the relative intensity loss (K,) above which a pixel touches; NaN: nothing touches."""
        ...

    def threshold(self, images: Images, light: GlassLight) -> Array:
        """(K,) relative intensity loss half-way between ridges and the skin beside them; NaN without contact."""
        ...

    def covered(self, density_margin: Array, points: Array, topography_to_contact: Array) -> Array:
        """(K, N) bool, whether the apparent contact covers points (K, N, 2) px of the topography view; (2, 3)."""
        ...

    def detect(self, image: Images, mask: Array, count: int) -> Array:
        """(n, 2) px, up to `count` points worth tracking in the part (H, W) bool of a view; the strongest first."""
        ...

    def key(self, image: Images) -> KeyFrame:
        """A copy of a frame (1, 1, H, W), with its noise."""
        ...

    def prepare(self, key: KeyFrame, points: Array, warp: Array | None = None) -> TemplateBuffers:
        """Templates of points (N, 2) px of a key frame, for its deformation (N, 2, 2); NaN points match nothing."""
        ...

    def update(self, templates: Any, rows: Array, updated: Any) -> None:
        """Replaces the templates of these rows (L,) by those of `prepare`."""
        ...

    def follow(self, templates: Any, images: Images, place: Array, speed: Array, rows: Array | None = None) -> Followed:
        """Templates, or some rows (L,) of them, found in frames that follow each other.

        They are expected at `place` + `speed` (N or L, 2) in the first one, and on by the rule of `tracker.motion`. A
        point that lies further off than a look reaches is looked for where this has led, up to five times.
        """
        ...

    def correct(self, start: Array, found: FoundPoints, numbers: Array, inverse_warp: Array) -> Corrected:
        """Corrects for the deformation that templates do not know (`graphs.DeformationGraph`).

        Start (N, 2) px in the key frame, numbers (N, 32) and inverse deformation (N, 2, 2) of the templates.
        """
        ...

    def neighbours(self, start: Array) -> Any:
        """What `outliers` needs to know of points (N, 2) px of a key frame."""
        ...

    def outliers(self, neighbours: Any, start: Array, found: FoundPoints) -> tuple[Array, Array]:
        """(K, N) bool twice: off their neighbours, and far more uncertain than they (`ops.tracking.outliers`)."""
        ...

    def search(self, key: KeyFrame, image: Images, points: Array, guess: Array) -> tuple[Array, Array]:
        """Places (n, 2) px of points of a key frame around guesses (n, 2), and whether (n,) the way back returns."""
        ...

    def windows(self, images: Images, number: Array, places: Array, warp: Array, step: int) -> Array:
        """(N, m) grey levels on a grid of `step` px in deformed windows around places (N, 2) of frames (N,)."""
        ...

    def noise(self, image: Images) -> float:
        """Standard deviation of the white noise of a frame (1, 1, H, W), grey levels."""
        ...

    def fit(self, points: Array, values: Array, queries: Array, gauge: float, variance: Array | None = None) -> Fit:
        """`ops.local_gradients` in float64: points (N, 2), values (K, N, C), queries (Q, 2), variance (K, N)."""
        ...

    def fields(
        self,
        reference: Array,
        displacement: Array,
        ellipse: FrameEllipse,
        covariance: Array | None = None,
        entered: EnteredPoints | None = None,
    ) -> FrameFields:
        """Fields of displacements (K, N, 2) mm at reference positions (N, 2) mm over the gauge length."""
        ...


def nothing_found(frames: int) -> FoundPoints:
    """Of no points in so many frames."""
    none = np.zeros((frames, 0), np.float32)
    place = np.zeros((frames, 0, 2), np.float32)
    return FoundPoints(place, none, np.zeros((frames, 0, 2, 2), np.float32), none.astype(np.uint8), place)
