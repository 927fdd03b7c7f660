"""Engine that calls the compiled library with NumPy arrays, without torch."""

import math
from functools import partial

import numpy as np

from fingerflow.engines.engine import (
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
    Recent,
    TrackedPoints,
    reject_outliers,
)
from fingerflow.kernels import tracking
from fingerflow.kernels.arrays import KINDS, inverse_2x2
from fingerflow.kernels.contact import contact_threshold
from fingerflow.kernels.contact_sizes import block_of, cell_of
from fingerflow.kernels.detection_limits import NOISE, QUALITY
from fingerflow.kernels.field_limits import STRAIN_MEASURES
from fingerflow.kernels.fields import fields_of_frames, local_gradients
from fingerflow.kernels.library import compiled
from fingerflow.kernels.tracking_limits import MISMATCH_SHARE, ROUNDING, ROUNDS, WARP_GAUGE_PX
from fingerflow.schema.pixel_types import COMPUTED_TYPES


class _NativeTemplates:
    """Templates of N points: reference positions (1, N, 2), sampled grey levels of the windows around them, and
    statistics of these samples, which the kernel `prepare_templates` computes; key frame, and its noise.
    """

    def __init__(self, arrays: tuple[Array, Array, Array], key: Array, noise: float) -> None:
        self.arrays, self.key, self.noise = arrays, key, noise
        self.numbers: Array = arrays[2][0]

    def update(self, rows: Array, updated: "_NativeTemplates") -> None:
        for array, part in zip(self.arrays, updated.arrays, strict=True):
            array[:, rows] = part


class NativeEngine:
    """Engine that computes with the compiled library; it implements `engine.Engine`.

    Methods that call the library raise RuntimeError if it cannot be used.
    """

    name = described = "native"
    fixed = False

    def __init__(self, settings: EngineSettings) -> None:
        self.settings = settings
        self.cell_px = settings.cell_px or cell_of(settings.gross_radius_px)
        if self.cell_px > 2 * settings.gross_radius_px + 1:
            raise ValueError(f"cells of {self.cell_px} px: the boxes of {settings.gross_radius_px} px are narrower")
        self._block = block_of(settings.gross_radius_px)
        self._neighbours = Recent(partial(tracking.find_neighbours, gauge_length=WARP_GAUGE_PX))

    def images(self, frames: Array) -> Array:
        return frames.astype(COMPUTED_TYPES[KINDS[frames.dtype]], copy=False)[:, None]

    def contact(self, images: Array, light: GlassLight, threshold: Array | None = None) -> FrameContact:
        radius = self.settings.gross_radius_px
        if threshold is None:
            gains = self.contact(images, light, np.full(len(images), np.nan, np.float32)).illumination_gain
            sizes = {"median_px": self.settings.median_px, "radius": radius, "stride_px": self.settings.stride_px}
            threshold = contact_threshold(images, *light, gains, **sizes)
        mask, density_margin, numbers, gains = compiled("contact_of_frames")(
            frames=images,
            light=light[0],
            black=light[1],
            limits=(1 - threshold).astype(np.float32),
            size=self.settings.median_px,
            block=self._block,
            radius=radius,
            side=self.cell_px,
        )
        real, gross, center, axes, angle = numbers[:, 0], numbers[:, 1], numbers[:, 2:4], numbers[:, 4:6], numbers[:, 6]
        return FrameContact(mask, real, gross, center, axes, angle, density_margin, gains, threshold)

    def detect(self, image: Array, mask: Array, count: int) -> Array:
        count = min(count, mask.size)
        border = min(self.settings.window_px // 2 + 3, (min(mask.shape) - 1) // 2)
        beside = max(1, round(self.settings.min_distance_px / 2))
        farthest = max(beside + 1, math.isqrt(mask.size // count))
        limits = {"border": border, "beside": beside, "farthest": farthest, "quality": QUALITY, "noise": NOISE}
        points, _ = compiled("detect_points")(frame=image, mask=mask[None, None], count=count, **limits)
        return points[np.isfinite(points[:, 0])]

    def prepare(self, key: Array | _NativeTemplates, points: Array, warp: Array | None = None) -> _NativeTemplates:
        if isinstance(key, _NativeTemplates):
            image, noise = key.key, key.noise
        else:
            image = key.copy()
            noise = float(np.float32(math.sqrt(math.pi / 2) / 6 * compiled("mean_response")(frames=image)[0]))
        arrays = compiled("prepare_templates")(
            image=image,
            start=points.astype(np.float32, copy=False)[None],
            inverse_warp=None if warp is None else inverse_2x2(warp.astype(np.float32))[None],
            variance=np.square(np.array([noise], np.float32)),
            window=self.settings.window_px,
            gain_offset=self.settings.gain_offset,
            rounding=ROUNDING if image.dtype.kind in "iu" else 0.0,
        )
        return _NativeTemplates(arrays, image, noise)

    def track(
        self, templates: _NativeTemplates, images: Array, place: Array, speed: Array, rows: Array | None = None
    ) -> Followed:
        arrays = templates.arrays if rows is None else tuple(array[:, rows] for array in templates.arrays)
        rounding = ROUNDING if images.dtype.kind in "iu" else 0.0
        limits = (rounding, self.settings.forward_backward_limit_px, MISMATCH_SHARE)
        *points, place, speed = tracking.find_templates(arrays, images, place[None], speed[None], None, ROUNDS, *limits)
        return Followed(TrackedPoints(*[values[:, 0] for values in points]), place[0], speed[0])

    def correct(self, start: Array, found: TrackedPoints, numbers: Array, inverse_warp: Array) -> Corrected:
        if len(start) > 1:  # a single point has no neighbour
            moved, deviation = found.points - start, np.sqrt(found.variance)
            found = reject_outliers(found, *tracking.find_outliers(self._neighbours(start), moved, deviation))
        window, inputs = self.settings.window_px, (start, found.points, found.covariance, numbers, inverse_warp)
        points, covariance, *others = tracking.correct_points(*inputs, window=window, gauge_px=WARP_GAUGE_PX)
        return Corrected(TrackedPoints(points, found.error, covariance, found.status, found.estimate), *others)

    def search(self, templates: _NativeTemplates, image: Array, points: Array, guess: Array) -> tuple[Array, Array]:
        size, reach = tracking.sizes_of(self.settings.window_px, self.settings.search_px)
        positions = {"start": points, "guess": guess, "image_index": np.zeros(len(points), np.int64)}
        limit = self.settings.forward_backward_limit_px + tracking.SEARCHED
        search = {"size": size, "reach": reach, "limit": limit}
        return compiled("search_and_return")(key=templates.key, current=image, **positions, **search)

    def windows(self, images: Array, number: Array, places: Array, warp: Array) -> Array:
        grid = {"places": places.astype(np.float32), "warp": warp, "reach": self.settings.window_px // 2, "step": STEP}
        return compiled("sample_windows")(images=images, image_index=number, **grid)

    def fit(
        self, points: Array, values: Array, queries: Array, gauge: float, variance: Array | None = None
    ) -> tuple[Array, Array | None]:
        places, targets = points.astype(np.float64)[None], queries.astype(np.float64)[None]
        noise = None if variance is None else variance.astype(np.float64)[..., None]
        fit = local_gradients(places, values.astype(np.float64), targets, noise, radius=gauge / 2)
        return fit.gradient, fit.covariance

    def fields(
        self, reference: Array, displacement: Array, ellipse: FrameEllipse, covariance: Array | None = None,
        entered: EnteredPoints | None = None,
    ) -> FrameFields:  # fmt: skip
        measure, radius = STRAIN_MEASURES.index(self.settings.strain), self.settings.gauge_length_mm / 2
        inputs = reference, displacement, ellipse, covariance, entered
        return fields_of_frames(*inputs, measure=measure, radius=radius)
