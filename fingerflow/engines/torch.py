"""Engine that runs the modules of `graphs` with torch, on any device, also without compiled kernels."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from fingerflow.engines import engine as arrays
from fingerflow.engines.engine import Array, EngineSettings, Recent
from fingerflow.engines.prediction import MotionState
from fingerflow.graphs import ContactGraph, DetectGraph, FieldsGraph, KeyGraph, TrackGraph
from fingerflow.kernels.tracking_limits import ROUNDS, WARP_GAUGE_PX, TrackStatus
from fingerflow.ops.fields.local_fit import local_gradients
from fingerflow.ops.filters.noise import estimate_noise
from fingerflow.ops.tracking.deformation import correct_points
from fingerflow.ops.tracking.outliers import find_neighbours, find_outliers
from fingerflow.ops.tracking.search import search_and_return
from fingerflow.ops.tracking.templates import Templates, further_rounds
from fingerflow.ops.tracking.window_correlation import sample_windows


@dataclass
class _TorchTemplates:
    """Templates of N points, stored as tensors (1, N, ...) in an `ops.Templates`, with their statistics `numbers` (N,
    32) on the host; key frame, and its noise.
    """

    templates: Templates
    numbers: Array
    key: Tensor
    noise: float

    def update(self, rows: Array, updated: _TorchTemplates) -> None:
        chosen = torch.from_numpy(rows).to(self.key.device)
        for old, new in zip(self.templates, updated.templates, strict=True):
            if old is not None and new is not None:
                # In place: few rows are updated, and all templates take megabytes.
                old.index_copy_(1, chosen, new[:, : len(rows)])
        self.numbers[rows] = updated.numbers


class TorchEngine:
    """Engine that computes with torch on a device; it implements `engine.Engine`.

    Args:
        settings: of the engine.
        device: of the tensors.
    """

    name = "torch"

    def __init__(self, settings: EngineSettings, device: torch.device) -> None:
        self.settings, self._device = settings, device
        own = settings
        self._contact = ContactGraph(own.median_px, own.gross_radius_px, own.cell_px, own.stride_px)
        self._key = KeyGraph(own.window_px, own.gain_offset)
        self._track = TrackGraph(own.forward_backward_limit_px)
        self._fields = FieldsGraph(own.gauge_length_mm, own.strain)
        self.cell_px: int = self._contact.cell_px
        self.described = f"torch ({device})"
        self._light = Recent(lambda light: tuple(map(self._tensor, light)))
        self._neighbours = Recent(lambda start: find_neighbours(self._tensor(start)[None], WARP_GAUGE_PX))

    def _tensor(self, array: Array, dtype: torch.dtype | None = None) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self._device, dtype)

    def images(self, frames: Array) -> Tensor:
        return images_on(self._device, frames)

    def contact(self, images: Tensor, light: arrays.GlassLight, threshold: Array | None = None) -> arrays.FrameContact:
        glass = self._light(light)
        if threshold is None:
            threshold = _array(self._contact.threshold(images, *glass))
        limit = self._tensor(1 - threshold.astype(np.float32))
        contact: arrays.FrameContact = self._contact(images, *glass, limit)
        values = {name: _array(value) for name, value in contact._asdict().items() if value is not None}
        return contact._replace(**values, threshold=threshold)

    def detect(self, image: Tensor, mask: Array, count: int) -> Array:
        own = self.settings
        points, _ = DetectGraph(count, own.min_distance_px, own.window_px)(image, self._tensor(mask)[None, None])
        found = _array(points[0])
        return found[np.isfinite(found).all(-1)]

    def prepare(self, key: Tensor | _TorchTemplates, points: Array, warp: Array | None = None) -> _TorchTemplates:
        if isinstance(key, _TorchTemplates):
            image, noise = key.key, key.noise
        else:
            image, noise = key.clone(), float(estimate_noise(key))
        deformed = None if warp is None else self._tensor(warp)[None]
        deviation = self._tensor(np.array([noise], np.float32))
        templates = self._key(image, self._tensor(points)[None], deviation, deformed)
        return _TorchTemplates(templates, _array(templates.numbers[0]).copy(), image, noise)

    def track(
        self, templates: _TorchTemplates, images: Tensor, place: Array, speed: Array, rows: Array | None = None
    ) -> arrays.Followed:
        chosen = templates.templates if rows is None else templates.templates.of(self._tensor(rows)[None])
        motion, frames = MotionState.begin(place, speed), []
        for k in range(len(images)):
            look = partial(self._look, images[k : k + 1])
            first = look(chosen, self._tensor(motion.expect())[None])
            found = arrays.TrackedPoints(*_arrays(first))
            # This decision on the host costs no extra wait, as the host waits for the first round anyway.
            if (found.status == TrackStatus.NOT_CONVERGED).any():
                found = arrays.TrackedPoints(*_arrays(further_rounds(look, chosen, first, ROUNDS - 1)))
            motion = motion.see(found)
            frames.append(found)
        joined = arrays.TrackedPoints(*map(np.concatenate, zip(*frames, strict=True)))
        return arrays.Followed(joined, motion.place, motion.speed)

    def _look(self, image: Tensor, templates: Templates, near: Tensor) -> arrays.TrackedPoints:
        found: arrays.TrackedPoints = self._track(templates, image, near)
        return found

    def correct(
        self, start: Array, found: arrays.TrackedPoints, numbers: Array, inverse_warp: Array
    ) -> arrays.Corrected:
        if len(start) > 1:  # a single point has no neighbour
            moved = self._tensor(found.points) - self._tensor(start)[None]
            masks = find_outliers(self._neighbours(start), moved, self._tensor(np.sqrt(found.variance)))
            found = arrays.reject_outliers(found, *_arrays(masks))
        given = self._tensor(start)[None], self._tensor(found.points), self._tensor(found.covariance)
        of_templates = self._tensor(numbers)[None], self._tensor(inverse_warp)[None]
        corrected = correct_points(*given, *of_templates, self.settings.window_px, WARP_GAUGE_PX)
        points, covariance, *others = _arrays(corrected)
        return arrays.Corrected(found._replace(points=points, covariance=covariance), *others)

    def search(self, templates: _TorchTemplates, image: Tensor, points: Array, guess: Array) -> tuple[Array, Array]:
        own = self.settings
        number = torch.zeros(len(points), dtype=torch.int64, device=self._device)
        given = (number, self._tensor(points), self._tensor(guess))
        reach = (own.window_px, own.search_px, own.forward_backward_limit_px)
        places, returns = search_and_return(templates.key, image, *given, *reach)
        return _array(places), _array(returns)

    def windows(self, images: Tensor, number: Array, places: Array, warp: Array, step: int) -> Array:
        given = (self._tensor(number), self._tensor(places), self._tensor(warp))
        return _array(sample_windows(images, *given, self.settings.window_px, step))

    def fit(
        self, points: Array, values: Array, queries: Array, gauge: float, variance: Array | None = None
    ) -> tuple[Array, Array | None]:
        wide = partial(self._tensor, dtype=torch.float64)
        noise = None if variance is None else wide(variance)
        found = local_gradients(
            wide(points)[None], wide(values), wide(queries)[None], gauge_length=gauge, variance=noise
        )
        return _array(found.gradient), None if found.covariance is None else _array(found.covariance)

    def fields(
        self,
        reference: Array,
        displacement: Array,
        ellipse: arrays.FrameEllipse,
        covariance: Array | None = None,
        entered: arrays.EnteredPoints | None = None,
    ) -> arrays.FrameFields:
        single = partial(self._tensor, dtype=torch.float32)
        variance = None if covariance is None else single(covariance)
        advected = None
        if entered is not None:
            spread = None if entered.covariance is None else single(entered.covariance)
            advected = arrays.EnteredPoints(self._tensor(entered.among), single(entered.gradient), spread)
        found = self._fields(
            single(reference)[None],
            single(displacement),
            variance,
            arrays.FrameEllipse(*map(single, ellipse)),
            advected,
        )
        known: dict[str, Any] = {name: None if one is None else _array(one) for name, one in found._asdict().items()}
        return arrays.FrameFields(**known)


def _array(tensor: Tensor) -> Array:
    """Return a tensor as an array; on the CPU they share memory."""
    array: Array = tensor.detach().cpu().numpy()
    return array


def _arrays(tensors: Iterable[Tensor]) -> list[Array]:
    return [_array(one) for one in tensors]


def images_on(device: torch.device, frames: Array) -> Tensor:
    """Return the images (K, H, W) of K frames as a tensor (K, 1, H, W) on a device.

    It must not be written to: on the CPU it shares memory with the frames unless these are converted. uint16 becomes
    int32, with which torch can compute, and float64 becomes float32.
    """
    if frames.dtype == np.uint16:
        frames = frames.astype(np.int32)
    elif frames.dtype == np.float64:
        frames = frames.astype(np.float32)
    elif not frames.flags.writeable:
        frames = np.asarray(_DeclaredWritable(frames))
    return torch.from_numpy(frames).to(device)[:, None]


class _DeclaredWritable:
    """Wrapper that declares a read-only array, such as a memory map, writable, so that torch does not warn of it.

    Torch warns of read-only arrays, and engines only read.
    """

    def __init__(self, array: Array) -> None:
        self._array = array  # keeps the array's memory alive as long as the pointer is used
        address = array.__array_interface__["data"][0]
        self.__array_interface__ = {**array.__array_interface__, "data": (address, False)}
