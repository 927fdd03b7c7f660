"""Engine that runs the modules of `graphs` with torch, on any device, also without compiled kernels."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from fingerflow.engines import engine as arrays
from fingerflow.engines.engine import Array, EngineSettings
from fingerflow.engines.padding import filled, parts, stacked
from fingerflow.engines.prediction import MotionState
from fingerflow.graphs import (
    ContactGraph,
    DeformationGraph,
    Entered,
    FieldsGraph,
    GrossEllipse,
    KeyGraph,
    LightGraph,
    TrackGraph,
)
from fingerflow.graphs.detect import DetectGraph
from fingerflow.graphs.track import AgreementGraph
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.tracking_limits import MISMATCH_SHARE, ROUNDS, WARP_GAUGE_PX, TrackStatus
from fingerflow.ops.contact.cells import covered
from fingerflow.ops.fields.local_fit import local_gradients
from fingerflow.ops.filters.noise import estimate_noise, rounding_variance
from fingerflow.ops.tracking.outliers import Neighbours, find_neighbours
from fingerflow.ops.tracking.search import search_and_return
from fingerflow.ops.tracking.templates import Found, Templates, further_rounds
from fingerflow.ops.tracking.window_correlation import sample_windows

Modules = Callable[[Any], Any]  # function from a module to the callable that replaces it
_Many = Sequence[tuple[Any, ...]]  # arguments of one method, by recording


@dataclass
class _TorchTemplates:
    """Templates of N points, stored as tensors (1, N, ...) in an `ops.Templates`."""

    templates: Templates

    @property
    def numbers(self) -> Array:
        return _array(self.templates.numbers[0])


class TorchEngine:
    """Engine that computes with torch on a device; it implements `engine.Engine`.

    Args:
        settings: of the engine.
        device: of the tensors.
        modules: returns the callable that replaces a module: itself, or one that computes the same elsewhere.
    """

    name = "torch"

    def __init__(
        self, settings: EngineSettings, device: torch.device, modules: Modules = lambda module: module
    ) -> None:
        self.settings, self._device, self._modules = settings, device, modules
        own = settings
        self._contact = modules(ContactGraph(own.median_px, own.gross_radius_px, own.cell_px, own.stride_px))
        self._key = modules(KeyGraph(own.window_px, own.gain_offset))
        self._track = modules(TrackGraph(own.forward_backward_limit_px))
        self._deformation = modules(DeformationGraph(own.window_px))
        self._agreement = modules(AgreementGraph())
        self._fields = modules(FieldsGraph(own.gauge_length_mm, own.strain))
        self._light = modules(LightGraph())
        self.cell_px: int = self._contact.cell_px
        self.described = f"torch ({device})"

    def _tensor(self, array: Array, dtype: torch.dtype | None = None) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self._device, dtype)

    def images(self, frames: Array) -> Tensor:
        return images_on(self._device, frames)

    def light(self, empty: Array, dark: Array | None, inside: Array | None = None) -> arrays.GlassLight:
        unknown = torch.full((1,), torch.nan, device=self._device)
        given = (
            self._tensor(empty, torch.float32)[None, None],
            None if dark is None else self._tensor(dark)[None, None],
        )
        light, black, _ = self._light(*given, unknown)
        if inside is not None:
            light = torch.where(self._tensor(inside), light, 0.0)
        return arrays.GlassLight(light, black)

    def contact(self, images: Tensor, light: arrays.GlassLight, threshold: Array) -> arrays.FrameContact:
        return self._contact_of([(images, light, threshold)])[0]

    def threshold(self, images: Tensor, light: arrays.GlassLight) -> Array:
        return self._threshold_of([(images, light)])[0]

    def covered(self, density_margin: Array, points: Array, topography_to_contact: Array) -> Array:
        matrix = self._tensor(topography_to_contact, torch.float32)
        # Put components before points, since torch is slow on a short last axis.
        x, y = (matrix[:, :2] @ self._tensor(points).mT + matrix[:, 2:]).unbind(1)
        return _array(covered(self._tensor(density_margin), x, y, self.cell_px))

    def detect(self, image: Tensor, mask: Array, count: int) -> Array:
        own = self.settings
        # `modules` does not replace this module: each number of points would need another graph, and most are used
        # once.
        detect = DetectGraph(count, own.min_distance_px, own.window_px)
        points, _ = detect(image, self._tensor(mask)[None, None])
        return _array(points[0][points[0].isfinite().all(-1)])

    def key(self, image: Tensor) -> arrays.KeyFrame:
        return arrays.KeyFrame(image.clone(), self.noise(image))

    def noise(self, image: Tensor) -> float:
        return self._noise_of([(image,)])[0]

    def prepare(self, key: arrays.KeyFrame, points: Array, warp: Array | None = None) -> _TorchTemplates:
        return self._prepare_of([(key, points, warp)])[0]

    def update(self, templates: _TorchTemplates, rows: Array, updated: _TorchTemplates) -> None:
        chosen = self._tensor(rows)
        for old, new in zip(templates.templates, updated.templates, strict=True):
            if old is not None and new is not None:
                old.index_copy_(1, chosen, new)  # in place: few rows are updated, and all templates take megabytes

    def follow(
        self, templates: _TorchTemplates, images: Tensor, place: Array, speed: Array, rows: Array | None = None
    ) -> arrays.Followed:
        return self._follow_of([(templates, images, place, speed, rows)])[0]

    def correct(self, start: Array, found: arrays.FoundPoints, numbers: Array, inverse_warp: Array) -> arrays.Corrected:
        return self._correct_of([(start, found, numbers, inverse_warp)])[0]

    def neighbours(self, start: Array) -> Neighbours:
        return find_neighbours(self._tensor(start)[None], WARP_GAUGE_PX)

    def outliers(self, neighbours: Neighbours, start: Array, found: arrays.FoundPoints) -> tuple[Array, Array]:
        return self._outliers_of([(neighbours, start, found)])[0]

    def search(self, key: arrays.KeyFrame, image: Tensor, points: Array, guess: Array) -> tuple[Array, Array]:
        own = self.settings
        given = (
            torch.zeros(len(points), dtype=torch.int64, device=self._device),
            self._tensor(points),
            self._tensor(guess),
        )
        reach = (own.window_px, own.search_px, own.forward_backward_limit_px)
        places, returns = search_and_return(key.image, image, *given, *reach)
        return _array(places), _array(returns)

    def windows(self, images: Tensor, number: Array, places: Array, warp: Array, step: int) -> Array:
        return self._windows_of([(images, number, places, warp, step)])[0]

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
        real = partial(self._tensor, dtype=torch.float32)
        own = None
        if entered is not None:
            of_own = None if entered.covariance is None else real(entered.covariance)
            own = Entered(self._tensor(entered.among), real(entered.gradient), of_own)
        found = self._fields(
            real(reference)[None],
            real(displacement),
            None if covariance is None else real(covariance),
            GrossEllipse(*map(real, ellipse)),
            own,
        )
        given = {name: one for name, one in found._asdict().items() if one is not None}
        known: Any = {**dict.fromkeys(found._fields), **dict(zip(given, _arrays(given.values()), strict=True))}
        return arrays.FrameFields(**known)

    def kind(self) -> object:
        """Return a value by which engines are grouped: calls of engines of equal value can be computed in one batch.

        See `together.BatchingEngine`. With compiled kernels no calls are joined: it would not be faster, and results of
        a recording stay independent of the others.
        """
        compiled = self._device.type == "cpu" and kernels.serve()
        return id(self) if compiled else (type(self), self.settings, self._device, id(self._modules))

    def joined(self, method: str, many: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Compute the engine method named `method` for several recordings, given the arguments `many` of each, in one
        batch for each image size and dtype; return the result of each.
        """
        alike: dict[Any, list[int]] = {}
        for place, one in enumerate(many):
            alike.setdefault(tuple(map(_batch_key, one)), []).append(place)
        results: dict[int, Any] = {}
        for places in alike.values():
            results |= zip(places, getattr(self, f"_{method}_of")([many[place] for place in places]), strict=True)
        return [results[place] for place in range(len(many))]

    def _contact_of(self, many: _Many) -> list[arrays.FrameContact]:
        images, light, black = self._join_light([(images, light) for images, light, _ in many])
        limit = 1 - self._tensor(np.concatenate([threshold for *_, threshold in many]), torch.float32)
        found = _arrays(self._contact(images, light, black, limit))
        return [arrays.FrameContact(*(one[frames] for one in found)) for frames in parts(len(one[0]) for one in many)]

    def _threshold_of(self, many: _Many) -> list[Array]:
        found = _array(self._contact.threshold(*self._join_light(many)))
        return [found[frames] for frames in parts(len(images) for images, _ in many)]

    def _join_light(self, many: _Many) -> tuple[Tensor, Tensor, Tensor]:
        """Return the frames of several recordings as one batch, with the light and the black level of each frame.

        Light and black level of a single recording stay (1, ...).
        """
        if len(many) == 1:
            images, light = many[0]
            return images, light.light, light.black
        both = [[one.expand(len(images), -1, -1, -1) for one in light] for images, light in many]
        light, black = (torch.cat(one) for one in zip(*both, strict=True))
        return _concatenate_frames([images for images, _ in many]), light, black

    def _noise_of(self, many: _Many) -> list[float]:
        found: list[float] = estimate_noise(_concatenate_frames([image for (image,) in many])).tolist()
        return found

    def _prepare_of(self, many: _Many) -> list[_TorchTemplates]:
        keys, points, warps = zip(*many, strict=True)
        warp = None if warps[0] is None else self._tensor(stacked(warps))
        noise = self._tensor(np.array([key.noise for key in keys], np.float32))
        images = _concatenate_frames([key.image for key in keys])
        templates = self._key(images, self._tensor(stacked(points)), noise, warp)
        return [
            _TorchTemplates(Templates._make(one[k : k + 1, : len(own)] for one in templates))
            for k, own in enumerate(points)
        ]

    def _follow_of(self, many: _Many) -> list[arrays.Followed]:
        held, images, places, speeds, rows = zip(*many, strict=True)
        counts, frames = [len(one) for one in places], [len(one) for one in images]
        size = len(many), max(counts)
        templates = self._stacked_templates(held, rows)
        if kernels.fused_serves(templates.samples, *images):
            return self._follow_fused(templates, images, places, speeds)
        # Concatenate the points of all recordings; a recording with fewer frames repeats its last frame until the
        # others end.
        courses = [MotionState.begin(*(stacked(one).reshape(-1, 2) for one in (places, speeds)))]
        every = []
        for k in range(max(frames)):
            image = _concatenate_frames([one[min(k, len(one) - 1)][None] for one in images])
            guess = self._tensor(courses[k].expect().reshape(*size, 2))
            look = partial(self._look, image)
            first = look(templates, guess)
            found = _arrays(first)
            # This decision on the host costs no extra wait, as the host waits for the first round anyway.
            if (arrays.FoundPoints(*found).status == TrackStatus.NOT_CONVERGED).any():
                found = _arrays(further_rounds(look, templates, first, ROUNDS - 1))
            courses.append(courses[k].see(arrays.FoundPoints(*(one.reshape(1, -1, *one.shape[2:]) for one in found))))
            every.append(found)
        joined = [np.stack(one) for one in zip(*every, strict=True)]  # (K, B, N, ...)
        results = []
        for place, (last, count) in enumerate(zip(frames, counts, strict=True)):
            own = arrays.FoundPoints(*(one[:last, place, :count] for one in joined))
            after = (one.reshape(*size, 2)[place, :count] for one in courses[last][:2])
            results.append(arrays.Followed(own, *after))
        return results

    def _follow_fused(
        self, templates: Templates, images: Sequence[Tensor], places: Sequence[Array], speeds: Sequence[Array]
    ) -> list[arrays.Followed]:
        """Track the templates of several recordings through all frames of each in one GPU kernel launch (Triton), from
        the positions `places` and `speeds` of the points before the first frame.
        """
        from fingerflow.kernels.tensors.fused_tracking import find_templates  # imported here, as it needs Triton

        views = nn.utils.rnn.pad_sequence(list(images)).flatten(0, 1)  # frame k of recording b has the index k B + b
        lengths = self._tensor(np.array([len(one) for one in images], np.int32))
        limits = rounding_variance(views), self.settings.forward_backward_limit_px, MISMATCH_SHARE
        near = self._tensor(stacked(places)), self._tensor(stacked(speeds))
        *found, place, speed = _arrays(find_templates(templates, views, *near, None, ROUNDS, *limits, lengths))
        return [
            arrays.Followed(
                arrays.FoundPoints(*(one[: len(frames), b, : len(own)] for one in found)),
                place[b, : len(own)],
                speed[b, : len(own)],
            )
            for b, (frames, own) in enumerate(zip(images, places, strict=True))
        ]

    def _stacked_templates(self, held: Sequence[_TorchTemplates], rows: Sequence[Array | None]) -> Templates:
        """Return the templates of B recordings, of all points or of those with the indices `rows`, padded to equal
        numbers of points and stacked along a first axis of length B.
        """
        every = [
            one.templates if some is None else one.templates.of(self._tensor(some)[None])
            for one, some in zip(held, rows, strict=True)
        ]
        if len(every) == 1:
            return every[0]
        return Templates._make(
            nn.utils.rnn.pad_sequence([one[0] for one in some], True, torch.nan) for some in zip(*every, strict=True)
        )

    def _look(self, image: Tensor, templates: Templates, near: Tensor) -> Found:
        found: Found = self._track(templates, image, near)
        return found

    def _correct_of(self, many: _Many) -> list[arrays.Corrected]:
        starts, founds, numbers, inverses = zip(*many, strict=True)
        counts = [len(one) for one in starts]
        own, found = self._join_found(founds)
        known = [self._repeat_for_frames(one, own) for one in (starts, numbers, inverses)]
        corrected, *others = self._deformation(known[0], Found(*map(self._tensor, found)), *known[1:])
        copied = _arrays((*corrected, *others))
        every = copied[: len(corrected)], copied[len(corrected) :]
        return [
            arrays.Corrected(
                arrays.FoundPoints(*(one[k, :count] for one in every[0])), *(one[k, :count] for one in every[1])
            )
            for k, count in zip(parts(len(one.status) for one in founds), counts, strict=True)
        ]

    def _outliers_of(self, many: _Many) -> list[tuple[Array, Array]]:
        neighbours, starts, founds = zip(*many, strict=True)
        counts = [len(one) for one in starts]
        own, found = self._join_found(founds)
        if own is None:
            near = neighbours[0]
        else:
            most = max(counts)
            filled_up = [
                (
                    functional.pad(one.number, (0, most - count)),
                    functional.pad(one.offset, (0, 0, 0, most - count)),
                    functional.pad(one.within, (0, most - count)),
                )
                for one, count in zip(neighbours, counts, strict=True)
            ]
            near = Neighbours(*(torch.cat(one)[own] for one in zip(*filled_up, strict=True)))
        deviation = self._tensor(np.sqrt(found.variance))
        judged = self._agreement(near, self._repeat_for_frames(starts, own), self._tensor(found.points), deviation)
        off, uncertain = _arrays(judged)
        return [
            (off[k, :count], uncertain[k, :count])
            for k, count in zip(parts(len(one.status) for one in founds), counts, strict=True)
        ]

    def _join_found(self, founds: Sequence[arrays.FoundPoints]) -> tuple[Tensor | None, arrays.FoundPoints]:
        """Concatenate the tracking results of several recordings along the frames, padded to equal numbers of points;
        return the recording index of each frame, and the joint results.

        The first result is None for a single recording.
        """
        if len(founds) == 1:
            return None, founds[0]
        most = max(one.status.shape[1] for one in founds)
        given = zip(*founds, strict=True)
        found = arrays.FoundPoints(*(np.concatenate([filled(one, most, axis=1) for one in some]) for some in given))
        frames = [len(one.status) for one in founds]
        return self._tensor(np.repeat(np.arange(len(founds)), frames)), found

    def _repeat_for_frames(self, values: Sequence[Array], own: Tensor | None) -> Tensor:
        """Return one array `values` (N, ...) per recording as a tensor (frames, N, ...), each repeated for the frames
        of its recording; `own` (frames,) is the index of the recording of each frame.

        The result is (1, N, ...) for a single recording.
        """
        given = self._tensor(stacked(values))
        return given if own is None else given[own]

    def _windows_of(self, many: _Many) -> list[Array]:
        images, numbers, places, warps, steps = zip(*many, strict=True)
        frames = parts(len(one) for one in images)
        number = np.concatenate([one + some.start for one, some in zip(numbers, frames, strict=True)])
        place, warp = (self._tensor(np.concatenate(one)) for one in (places, warps))
        window = self.settings.window_px
        found = _array(sample_windows(_concatenate_frames(images), self._tensor(number), place, warp, window, steps[0]))
        return [found[some] for some in parts(len(one) for one in places)]


def images_on(device: torch.device, frames: Array) -> Tensor:
    """Convert the images (K, H, W) of K frames to a tensor (K, 1, H, W) on a device.

    It must not be written to: on the CPU it shares memory with the frames unless these are converted. uint16 becomes
    int32, with which torch can compute, and float64 becomes float32.
    """
    if frames.dtype == np.uint16:
        frames = frames.astype(np.int32)
    elif frames.dtype == np.float64:
        frames = frames.astype(np.float32)
    elif not frames.flags.writeable:
        frames = np.asarray(_DeclaredWritable(frames))
    images = torch.from_numpy(frames)[:, None]
    return _upload(images, device) if device.type == "cuda" else images.to(device)


def _upload(images: Tensor, device: torch.device) -> Tensor:
    """Copy images to a GPU while the GPU computes: from page-locked memory, on a CUDA stream of its own."""
    ahead, current = _upload_stream(device), torch.cuda.current_stream(device)
    with torch.cuda.stream(ahead):
        there = images.pin_memory().to(device, non_blocking=True)
    current.wait_stream(ahead)
    there.record_stream(current)  # keeps the memory from being reused before `current` has read it
    return there


@cache
def _upload_stream(device: torch.device) -> torch.cuda.Stream:
    return torch.cuda.Stream(device)


class _DeclaredWritable:
    """Wrapper that declares a read-only array, such as a memory map, writable, so that torch does not warn of it.

    Torch warns of read-only arrays, and engines only read.
    """

    def __init__(self, array: Array) -> None:
        self._array = array  # keeps the array's memory alive as long as the pointer is used
        address = array.__array_interface__["data"][0]
        self.__array_interface__ = {**array.__array_interface__, "data": (address, False)}


def _concatenate_frames(images: Sequence[Tensor]) -> Tensor:
    """Concatenate the frames of several recordings to one batch."""
    return images[0] if len(images) == 1 else torch.cat(list(images))


def _batch_key(argument: Any) -> object:
    """Return a key of an argument, from its size and dtype: calls with equal keys can be computed in one batch."""
    if isinstance(argument, Tensor):
        return argument.dtype, argument.shape[1:]
    if isinstance(argument, arrays.GlassLight):
        return _batch_key(argument.light)
    if isinstance(argument, arrays.KeyFrame):
        return _batch_key(argument.image)
    if isinstance(argument, Neighbours):
        return argument.number.shape[1]
    return argument if isinstance(argument, int) else argument is None


def _array(tensor: Tensor) -> Array:
    return _arrays([tensor])[0]


def _arrays(tensors: Iterable[Tensor]) -> list[Array]:
    """Copy tensors to the CPU and return them as NumPy arrays, waiting for the GPU once for all of them."""
    given = [tensor.detach() for tensor in tensors]
    copies = [one.to("cpu", non_blocking=one.is_cuda) for one in given]
    if any(one.is_cuda for one in given):
        torch.cuda.current_stream().synchronize()
    return [one.numpy() for one in copies]
