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
from fingerflow.engines.cells import covered
from fingerflow.engines.engine import Array, EngineSettings
from fingerflow.engines.prediction import MotionState
from fingerflow.graphs import ContactGraph, DetectGraph, Entered, FieldsGraph, GrossEllipse, KeyGraph, TrackGraph
from fingerflow.kernels.tracking_limits import ROUNDS, WARP_GAUGE_PX, TrackStatus
from fingerflow.ops.fields.local_fit import local_gradients
from fingerflow.ops.filters.illumination import glass_light
from fingerflow.ops.filters.noise import estimate_noise
from fingerflow.ops.tracking.deformation import correct_points
from fingerflow.ops.tracking.outliers import Neighbours, find_neighbours, find_outliers
from fingerflow.ops.tracking.search import search_and_return
from fingerflow.ops.tracking.templates import Found, Templates, further_rounds
from fingerflow.ops.tracking.window_correlation import sample_windows


@dataclass
class _TorchTemplates:
    """Templates of N points, stored as tensors (1, N, ...) in an `ops.Templates`, with their statistics `numbers` (N,
    32) on the host.
    """

    templates: Templates
    numbers: Array


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

    def _tensor(self, array: Array, dtype: torch.dtype | None = None) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self._device, dtype)

    def images(self, frames: Array) -> Tensor:
        return images_on(self._device, frames)

    def light(self, empty: Array, dark: Array | None, inside: Array | None = None) -> arrays.GlassLight:
        unlit = None if dark is None else self._tensor(dark)[None, None]
        light, black = glass_light(self._tensor(empty, torch.float32)[None, None], unlit)
        if inside is not None:
            light = torch.where(self._tensor(inside), light, 0.0)
        return arrays.GlassLight(light, black)

    def contact(self, images: Tensor, light: arrays.GlassLight, threshold: Array) -> arrays.FrameContact:
        limit = self._tensor(1 - threshold.astype(np.float32))
        return arrays.FrameContact(*_arrays(self._contact(images, light.light, light.black, limit)))

    def threshold(self, images: Tensor, light: arrays.GlassLight) -> Array:
        return _array(self._contact.threshold(images, light.light, light.black))

    def covered(self, density_margin: Array, points: Array, topography_to_contact: Array) -> Array:
        return covered(density_margin, points, topography_to_contact, self.cell_px)

    def detect(self, image: Tensor, mask: Array, count: int) -> Array:
        own = self.settings
        points, _ = DetectGraph(count, own.min_distance_px, own.window_px)(image, self._tensor(mask)[None, None])
        found = _array(points[0])
        return found[np.isfinite(found).all(-1)]

    def key(self, image: Tensor) -> arrays.KeyFrame:
        return arrays.KeyFrame(image.clone(), self.noise(image))

    def noise(self, image: Tensor) -> float:
        return float(estimate_noise(image))

    def prepare(self, key: arrays.KeyFrame, points: Array, warp: Array | None = None) -> _TorchTemplates:
        noise = self._tensor(np.array([key.noise], np.float32))
        deformed = None if warp is None else self._tensor(warp)[None]
        templates = self._key(key.image, self._tensor(points)[None], noise, deformed)
        return _TorchTemplates(templates, _array(templates.numbers[0]).copy())

    def update(self, templates: _TorchTemplates, rows: Array, updated: _TorchTemplates) -> None:
        chosen = self._tensor(rows)
        for old, new in zip(templates.templates, updated.templates, strict=True):
            if old is not None and new is not None:
                # In place: few rows are updated, and all templates take megabytes.
                old.index_copy_(1, chosen, new[:, : len(rows)])
        templates.numbers[rows] = updated.numbers

    def follow(
        self, templates: _TorchTemplates, images: Tensor, place: Array, speed: Array, rows: Array | None = None
    ) -> arrays.Followed:
        chosen = templates.templates if rows is None else templates.templates.of(self._tensor(rows)[None])
        motion, frames = MotionState.begin(place, speed), []
        for k in range(len(images)):
            look = partial(self._look, images[k : k + 1])
            first = look(chosen, self._tensor(motion.expect())[None])
            found = arrays.FoundPoints(*_arrays(first))
            # This decision on the host costs no extra wait, as the host waits for the first round anyway.
            if (found.status == TrackStatus.NOT_CONVERGED).any():
                found = arrays.FoundPoints(*_arrays(further_rounds(look, chosen, first, ROUNDS - 1)))
            motion = motion.see(found)
            frames.append(found)
        joined = arrays.FoundPoints(*map(np.concatenate, zip(*frames, strict=True)))
        return arrays.Followed(joined, motion.place, motion.speed)

    def _look(self, image: Tensor, templates: Templates, near: Tensor) -> Found:
        found: Found = self._track(templates, image, near)
        return found

    def correct(self, start: Array, found: arrays.FoundPoints, numbers: Array, inverse_warp: Array) -> arrays.Corrected:
        given = self._tensor(start)[None], self._tensor(found.points), self._tensor(found.covariance)
        of_templates = self._tensor(numbers)[None], self._tensor(inverse_warp)[None]
        corrected = correct_points(*given, *of_templates, self.settings.window_px, WARP_GAUGE_PX)
        points, covariance, *others = _arrays(corrected)
        return arrays.Corrected(found._replace(points=points, covariance=covariance), *others)

    def neighbours(self, start: Array) -> Neighbours:
        return find_neighbours(self._tensor(start)[None], WARP_GAUGE_PX)

    def outliers(self, neighbours: Neighbours, start: Array, found: arrays.FoundPoints) -> tuple[Array, Array]:
        moved = self._tensor(found.points) - self._tensor(start)[None]
        off, uncertain = _arrays(find_outliers(neighbours, moved, self._tensor(np.sqrt(found.variance))))
        return off, uncertain

    def search(self, key: arrays.KeyFrame, image: Tensor, points: Array, guess: Array) -> tuple[Array, Array]:
        own = self.settings
        number = torch.zeros(len(points), dtype=torch.int64, device=self._device)
        given = (number, self._tensor(points), self._tensor(guess))
        reach = (own.window_px, own.search_px, own.forward_backward_limit_px)
        places, returns = search_and_return(key.image, image, *given, *reach)
        return _array(places), _array(returns)

    def windows(self, images: Tensor, number: Array, places: Array, warp: Array, step: int) -> Array:
        given = (self._tensor(number), self._tensor(places), self._tensor(warp))
        return _array(sample_windows(images, *given, self.settings.window_px, step))

    def fit(
        self, points: Array, values: Array, queries: Array, gauge: float, variance: Array | None = None
    ) -> arrays.Fit:
        wide = partial(self._tensor, dtype=torch.float64)
        noise = None if variance is None else wide(variance)
        found = local_gradients(
            wide(points)[None], wide(values), wide(queries)[None], gauge_length=gauge, variance=noise
        )
        return arrays.Fit(_array(found.gradient), None if found.covariance is None else _array(found.covariance))

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
            advected = Entered(self._tensor(entered.among), single(entered.gradient), spread)
        found = self._fields(
            single(reference)[None], single(displacement), variance, GrossEllipse(*map(single, ellipse)), advected
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
