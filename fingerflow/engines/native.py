"""Engine that calls the compiled library with NumPy arrays, without torch."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fingerflow.engines.engine import (
    Array,
    Corrected,
    EngineSettings,
    EnteredPoints,
    Fit,
    Followed,
    FoundPoints,
    FrameContact,
    FrameEllipse,
    FrameFields,
    GlassLight,
    KeyFrame,
)
from fingerflow.engines.native_fields import fields_of_frames
from fingerflow.kernels import tracking
from fingerflow.kernels.arrays import inverse_2x2
from fingerflow.kernels.contact import contact_threshold
from fingerflow.kernels.contact_sizes import FULL_LIGHT, LEAST_LIGHT, PIXELS_OF_LIGHT, block_of, cell_of
from fingerflow.kernels.detection_limits import NOISE, QUALITY
from fingerflow.kernels.field_limits import MINIMUM_POINTS, MINIMUM_SPREAD
from fingerflow.kernels.fields import local_gradients
from fingerflow.kernels.library import run
from fingerflow.kernels.tracking_limits import MISMATCH_SHARE, ROUNDING, ROUNDS, WARP_GAUGE_PX


@dataclass
class _NativeTemplates:
    """Templates of N points: reference positions (1, N, 2), sampled grey levels of the windows around them, and
    statistics of these samples.

    They are the results of the kernel `prepare_templates`.
    """

    arrays: tuple[Array, Array, Array]

    @property
    def numbers(self) -> Array:
        numbers: Array = self.arrays[2][0]
        return numbers


class NativeEngine:
    """Engine that computes with the compiled library; it implements `engine.Engine`.

    Methods that call the library raise RuntimeError if it cannot be used.
    """

    name = described = "native"

    def __init__(self, settings: EngineSettings) -> None:
        self.settings = settings
        self.cell_px = settings.cell_px or cell_of(settings.gross_radius_px)
        if self.cell_px > 2 * settings.gross_radius_px + 1:
            raise ValueError(f"cells of {self.cell_px} px: the boxes of {settings.gross_radius_px} px are narrower")

    def images(self, frames: Array) -> Array:
        if frames.dtype == np.float64:
            frames = frames.astype(np.float32)
        return frames[:, None]

    def light(self, empty: Array, dark: Array | None, inside: Array | None = None) -> GlassLight:
        light, black = _glass_light(empty.astype(np.float32), dark)
        if inside is not None:
            light = np.where(inside, light, np.float32(0))
        return GlassLight(light[None, None], black[None, None])

    def contact(self, images: Array, light: GlassLight, threshold: Array) -> FrameContact:
        radius = self.settings.gross_radius_px
        mask, density_margin, numbers, gains = run(
            "contact_of_frames",
            frames=images,
            light=light.light,
            black=light.black,
            limits=(1 - threshold).astype(np.float32),
            size=self.settings.median_px,
            block=block_of(radius),
            radius=radius,
            side=self.cell_px,
        )
        real, gross, center, axes, angle = numbers[:, 0], numbers[:, 1], numbers[:, 2:4], numbers[:, 4:6], numbers[:, 6]
        return FrameContact(mask, real, gross, center, axes, angle, density_margin, gains)

    def threshold(self, images: Array, light: GlassLight) -> Array:
        sizes = {name: getattr(self.settings, name) for name in ("median_px", "stride_px")}
        unknown = np.full(len(images), np.nan, np.float32)
        gains = self.contact(images, light, unknown).illumination_gain
        return contact_threshold(
            *(images, light.light, light.black, gains), radius=self.settings.gross_radius_px, **sizes
        )

    def covered(self, density_margin: Array, points: Array, topography_to_contact: Array) -> Array:
        transform = topography_to_contact.astype(np.float32)
        contact = {"density_margin": density_margin, "side": self.cell_px}
        return run("covered", **contact, points=points, transform=transform)

    def detect(self, image: Array, mask: Array, count: int) -> Array:
        height, width = mask.shape
        count = min(count, mask.size)
        border = min(self.settings.window_px // 2 + 3, (min(mask.shape) - 1) // 2)
        beside = max(1, round(self.settings.min_distance_px / 2))
        farthest = max(beside + 1, math.isqrt(height * width // count))
        limits = {"border": border, "beside": beside, "farthest": farthest, "quality": QUALITY, "noise": NOISE}
        points, _ = run("detect_points", frame=image, mask=mask[None, None], count=count, **limits)
        return points[np.isfinite(points[:, 0])]

    def key(self, image: Array) -> KeyFrame:
        return KeyFrame(image.copy(), self.noise(image))

    def noise(self, image: Array) -> float:
        return float(np.float32(math.sqrt(math.pi / 2) / 6 * run("mean_response", frames=image)[0]))

    def prepare(self, key: KeyFrame, points: Array, warp: Array | None = None) -> _NativeTemplates:
        own = self.settings
        variance = np.square(np.array([key.noise], np.float32))
        inverse = None if warp is None else inverse_2x2(warp.astype(np.float32))[None]
        rounding = ROUNDING if key.image.dtype.kind in "iu" else 0.0
        arrays = {"image": key.image, "start": points[None], "inverse_warp": inverse, "variance": variance}
        sizes = {"window": own.window_px, "gain_offset": own.gain_offset, "rounding": rounding}
        return _NativeTemplates(run("prepare_templates", **arrays, **sizes))

    def update(self, templates: _NativeTemplates, rows: Array, updated: _NativeTemplates) -> None:
        for old, new in zip(templates.arrays, updated.arrays, strict=True):
            old[:, rows] = new

    def follow(
        self, templates: _NativeTemplates, images: Array, place: Array, speed: Array, rows: Array | None = None
    ) -> Followed:
        some = templates.arrays if rows is None else tuple(one[:, rows] for one in templates.arrays)
        rounding = ROUNDING if images.dtype.kind in "iu" else 0.0
        limits = (rounding, self.settings.forward_backward_limit_px, MISMATCH_SHARE)
        found = tracking.find_templates(some, images, place[None], speed[None], None, ROUNDS, *limits)
        return Followed(FoundPoints(*(one[:, 0] for one in found[:5])), found.place[0], found.speed[0])

    def correct(self, start: Array, found: FoundPoints, numbers: Array, inverse_warp: Array) -> Corrected:
        corrected = tracking.correct_points(
            *(start, found.points, found.covariance, numbers, inverse_warp),
            window=self.settings.window_px,
            gauge_px=WARP_GAUGE_PX,
        )
        better = found._replace(points=corrected.points, covariance=corrected.covariance)
        return Corrected(better, corrected.warp, corrected.shift, corrected.expected)

    def neighbours(self, start: Array) -> tracking.NeighbourLists:
        return tracking.find_neighbours(start, WARP_GAUGE_PX)

    def outliers(self, neighbours: tracking.NeighbourLists, start: Array, found: FoundPoints) -> tuple[Array, Array]:
        return tracking.find_outliers(neighbours, found.points - start, np.sqrt(found.variance))

    def search(self, key: KeyFrame, image: Array, points: Array, guess: Array) -> tuple[Array, Array]:
        size, reach = tracking.sizes_of(self.settings.window_px, self.settings.search_px)
        positions = {"start": points, "guess": guess, "image_index": np.zeros(len(points), np.int64)}
        limit = self.settings.forward_backward_limit_px + tracking.SEARCHED
        search = {"size": size, "reach": reach, "limit": limit}
        return run("search_and_return", key=key.image, current=image, **positions, **search)

    def windows(self, images: Array, number: Array, places: Array, warp: Array, step: int) -> Array:
        grid = {"places": places.astype(np.float32), "warp": warp, "reach": self.settings.window_px // 2, "step": step}
        return run("sample_windows", images=images, image_index=number, **grid)

    def fit(self, points: Array, values: Array, queries: Array, gauge: float, variance: Array | None = None) -> Fit:
        places, moved, asked = (np.ascontiguousarray(one, np.float64) for one in (points[None], values, queries[None]))
        noise = None if variance is None else variance.astype(np.float64)[..., None]
        radius = gauge / 2
        found = local_gradients(
            *(places, moved, asked, noise),
            radius=radius,
            least_spread=MINIMUM_SPREAD * radius,
            minimum_points=MINIMUM_POINTS,
        )
        return Fit(found.gradient, found.covariance)

    def fields(
        self,
        reference: Array,
        displacement: Array,
        ellipse: FrameEllipse,
        covariance: Array | None = None,
        entered: EnteredPoints | None = None,
    ) -> FrameFields:
        return fields_of_frames(
            *(reference[None], displacement),
            gauge_length=self.settings.gauge_length_mm,
            measure=self.settings.strain,
            ellipse=ellipse,
            covariance=covariance,
            entered=entered,
        )


def _glass_light(empty: Array, dark: Array | None) -> tuple[Array, Array]:
    """Compute light of the empty glass (0 at unlit pixels) and black level, as `ops.glass_light`.

    Images are (H, W).
    """
    black = np.zeros_like(empty) if dark is None else dark.astype(np.float32)
    light = empty - black
    step = max(1, min(light.shape) // PIXELS_OF_LIGHT)
    some = np.sort(light[::step, ::step], axis=None)
    some = some[np.isfinite(some)]
    full = some[max(math.ceil(len(some) * FULL_LIGHT), 1) - 1] if len(some) else math.nan
    lit = np.isfinite(light) & (light > 0) & (light > LEAST_LIGHT * full)
    return np.where(lit, light, np.float32(0)), np.where(np.isfinite(black), black, np.float32(0))
