"""Engine that runs the modules of `graphs` with torch, on any device, also without compiled kernels."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.utils._pytree import tree_leaves

from fingerflow.engines import engine as arrays
from fingerflow.engines.engine import ROWS, Array, EngineSettings
from fingerflow.engines.padding import filled, parts, stacked
from fingerflow.engines.points_graph import PointsGraph
from fingerflow.engines.prediction import MotionState
from fingerflow.engines.transfers import Transfers, transfers_of
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
_Result = TypeVar("_Result")
#: Computation of a method that yields tensors of the device, is sent them as arrays, and returns the results.
_Computation = Generator[Sequence[Tensor], list[Array], _Result]


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
        modules: returns the callable that replaces a module: itself, or one that computes the same elsewhere.
        transfers: copies to and from the device, by default those of `transfers_of`.
    """

    name = "torch"

    def __init__(
        self,
        settings: EngineSettings,
        device: torch.device,
        modules: Modules = lambda module: module,
        transfers: Transfers | None = None,
    ) -> None:
        self.settings, self._device, self._modules = settings, device, modules
        self._transfers = transfers or transfers_of(device)
        own = settings
        self._contact = modules(ContactGraph(own.median_px, own.gross_radius_px, own.cell_px, own.stride_px))
        self._key = modules(KeyGraph(own.window_px, own.gain_offset))
        self._track = modules(TrackGraph(own.forward_backward_limit_px))
        self._deformation = modules(DeformationGraph(own.window_px))
        self._agreement = modules(AgreementGraph())
        self._points = modules(PointsGraph(own.window_px, own.forward_backward_limit_px))
        self._fields = modules(FieldsGraph(own.gauge_length_mm, own.strain))
        self._light = modules(LightGraph())
        self.cell_px: int = self._contact.cell_px
        self.described = f"torch ({device})"

    def _tensor(self, array: Array, dtype: torch.dtype | None = None) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self._device, dtype)

    def _send(self, *arrays: Array) -> list[Tensor]:
        return self._transfers.send(arrays)

    def images(self, frames: Array) -> Tensor:
        return self.images_ahead(frames)()

    def images_ahead(self, frames: Array) -> Callable[[], Tensor]:
        """Begin to copy frames (K, H, W) to the device, and return a function that returns them as `images` does."""
        return images_ahead(self._transfers, frames)

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
        return self._compute(self._contact_of([(images, light, threshold)]))[0]

    def threshold(self, images: Tensor, light: arrays.GlassLight) -> Array:
        return self._compute(self._threshold_of([(images, light)]))[0]

    def covered(self, density_margin: Array, points: Array, topography_to_contact: Array) -> Array:
        return self._compute(self._covered_of([(density_margin, points, topography_to_contact)]))[0]

    def detect(self, image: Tensor, mask: Array, count: int) -> Array:
        own = self.settings
        # `modules` does not replace this module: each number of points would need another graph, and most are used
        # once.
        detect = DetectGraph(count, own.min_distance_px, own.window_px)
        points, _ = detect(image, self._tensor(mask)[None, None])
        (found,) = self._transfers.fetch([points[0]])()
        return found[np.isfinite(found).all(-1)]

    def key(self, image: Tensor) -> arrays.KeyFrame:
        return arrays.KeyFrame(image.clone(), self.noise(image))

    def noise(self, image: Tensor) -> float:
        return self._compute(self._noise_of([(image,)]))[0]

    def prepare(self, key: arrays.KeyFrame, points: Array, warp: Array | None = None) -> _TorchTemplates:
        return self._compute(self._prepare_of([(key, points, warp)]))[0]

    def update(self, templates: _TorchTemplates, rows: Array, updated: _TorchTemplates) -> None:
        chosen = self._tensor(rows)
        for old, new in zip(templates.templates, updated.templates, strict=True):
            if old is not None and new is not None:
                # In place: few rows are updated, and all templates take megabytes. Points after them are padding.
                old.index_copy_(1, chosen, new[:, : len(rows)])
        templates.numbers[rows] = updated.numbers

    def follow(
        self, templates: _TorchTemplates, images: Tensor, place: Array, speed: Array, rows: Array | None = None
    ) -> arrays.Followed:
        return self._compute(self._follow_of([(templates, images, place, speed, rows)]))[0]

    def track(
        self,
        templates: _TorchTemplates,
        images: Tensor,
        place: Array,
        speed: Array,
        neighbours: Neighbours,
        start: Array,
        inverse_warp: Array,
    ) -> arrays.Tracked:
        given = templates, images, place, speed, neighbours, start, inverse_warp
        return self._compute(self._track_of([given]))[0]

    def correct(self, start: Array, found: arrays.FoundPoints, numbers: Array, inverse_warp: Array) -> arrays.Corrected:
        return self._compute(self._correct_of([(start, found, numbers, inverse_warp)]))[0]

    def neighbours(self, start: Array) -> Neighbours:
        return find_neighbours(self._tensor(start)[None], WARP_GAUGE_PX)

    def outliers(self, neighbours: Neighbours, start: Array, found: arrays.FoundPoints) -> tuple[Array, Array]:
        return self._compute(self._outliers_of([(neighbours, start, found)]))[0]

    def search(self, key: arrays.KeyFrame, image: Tensor, points: Array, guess: Array) -> tuple[Array, Array]:
        own = self.settings
        given = (
            torch.zeros(len(points), dtype=torch.int64, device=self._device),
            self._tensor(points),
            self._tensor(guess),
        )
        reach = (own.window_px, own.search_px, own.forward_backward_limit_px)
        places, returns = search_and_return(key.image, image, *given, *reach)
        found, back = self._transfers.fetch([places, returns])()
        return found, back

    def windows(self, images: Tensor, number: Array, places: Array, warp: Array, step: int) -> Array:
        return self._compute(self._windows_of([(images, number, places, warp, step)]))[0]

    def fit(
        self, points: Array, values: Array, queries: Array, gauge: float, variance: Array | None = None
    ) -> arrays.Fit:
        wide = partial(self._tensor, dtype=torch.float64)
        noise = None if variance is None else wide(variance)
        found = local_gradients(
            wide(points)[None], wide(values), wide(queries)[None], gauge_length=gauge, variance=noise
        )
        known = [found.gradient] if found.covariance is None else [found.gradient, found.covariance]
        gradient, *covariance = self._transfers.fetch(known)()
        return arrays.Fit(gradient, covariance[0] if covariance else None)

    def fields(
        self,
        reference: Array,
        displacement: Array,
        ellipse: arrays.FrameEllipse,
        covariance: Array | None = None,
        entered: arrays.EnteredPoints | None = None,
    ) -> arrays.FrameFields:
        return self._compute(self._fields_of([(reference, displacement, ellipse, covariance, entered)]))[0]

    def kind(self) -> object:
        """Return a value by which engines are grouped: calls of engines of equal value can be computed in one batch.

        See `together.BatchingEngine`. With compiled kernels no calls are joined: it would not be faster, and results of
        a recording stay independent of the others.
        """
        compiled = self._device.type == "cpu" and kernels.serve()
        return id(self) if compiled else (type(self), self.settings, self._device, id(self._modules))

    @property
    def computes_behind(self) -> bool:
        """Return whether the device computes while the host goes on."""
        return self._transfers.behind

    def begun(self, method: str, many: Sequence[tuple[Any, ...]]) -> Callable[[], list[Any]]:
        """Begin to compute the engine method named `method` for several recordings, given the arguments `many` of each,
        in one batch for each image size and dtype; return a function that waits for the results, one for each
        recording.

        The fields of a recording, of many frames, are a batch of their own.
        """
        alike: dict[Any, list[int]] = {}
        for place, one in enumerate(many):
            alike.setdefault(place if method == "fields" else tuple(map(_batch_key, one)), []).append(place)
        computing = getattr(self, f"_{method}_of")
        batches = [(places, self._begin(computing([many[place] for place in places]))) for places in alike.values()]

        def results() -> list[Any]:
            found: dict[int, Any] = {}
            for places, finish in batches:
                found |= zip(places, finish(), strict=True)
            return [found[place] for place in range(len(many))]

        return results

    def _begin(self, computation: _Computation[_Result]) -> Callable[[], _Result]:
        """Launch a computation up to its first results, which are copied to the host behind it; return a function that
        waits for them, launches the rest, and returns the result.
        """
        fetched = self._transfers.fetch(next(computation))

        def finish() -> _Result:
            arrays = fetched()
            while True:
                try:
                    arrays = self._transfers.fetch(computation.send(arrays))()
                except StopIteration as end:
                    result: _Result = end.value
                    return result

        return finish

    def _compute(self, computation: _Computation[_Result]) -> _Result:
        return self._begin(computation)()

    def _contact_of(self, many: _Many) -> _Computation[list[arrays.FrameContact]]:
        images, light, black = self._join_light([(images, light) for images, light, _ in many])
        (limit,) = self._send(1 - np.concatenate([threshold for *_, threshold in many]).astype(np.float32))
        found = yield self._contact(images, light, black, limit)
        return [arrays.FrameContact(*(one[frames] for one in found)) for frames in parts(len(one[0]) for one in many)]

    def _threshold_of(self, many: _Many) -> _Computation[list[Array]]:
        (found,) = yield [self._contact.threshold(*self._join_light(many))]
        return [found[frames] for frames in parts(len(images) for images, _ in many)]

    def _covered_of(self, many: _Many) -> _Computation[list[Array]]:
        margins, points, matrices = zip(*many, strict=True)
        frames, most = [len(one) for one in points], max(one.shape[1] for one in points)
        margin, place, matrix = self._send(
            np.concatenate(margins),
            np.concatenate([filled(one, most, axis=1) for one in points]),
            np.repeat(np.stack(matrices).astype(np.float32), frames, axis=0),
        )
        # Put components before points, since torch is slow on a short last axis.
        x, y = (matrix[:, :, :2] @ place.mT + matrix[:, :, 2:]).unbind(1)
        (found,) = yield [covered(margin, x, y, self.cell_px)]
        return [found[some, : one.shape[1]] for some, one in zip(parts(frames), points, strict=True)]

    def _fields_of(self, many: _Many) -> _Computation[list[arrays.FrameFields]]:
        ((reference, displacement, ellipse, covariance, entered),) = many
        own = (None, None, None) if entered is None else (entered.gradient, entered.covariance, entered.among)
        given = [reference, displacement, covariance, *ellipse, *own]
        sent = iter(self._send(*(_real(one) for one in given if one is not None)))
        known: list[Any] = [None if one is None else next(sent) for one in given]
        points, moved, variance, *axes = known[:6]
        gradient, of_gradient, among = known[6:]
        advected = None if entered is None else Entered(among, gradient, of_gradient)
        fields = self._fields(points[None], moved, variance, GrossEllipse(*axes), advected)._asdict()
        computed = {name: one for name, one in fields.items() if one is not None}
        found = yield list(computed.values())
        every: dict[str, Any] = fields | dict(zip(computed, found, strict=True))
        return [arrays.FrameFields(**every)]

    def _join_light(self, many: _Many) -> tuple[Tensor, Tensor, Tensor]:
        """Return the frames of several recordings as one batch, with the light and the black level of each frame.

        Light and black level of a single recording stay (1, ...).
        """
        if len(many) == 1:
            images, light = many[0]
            return images, light.light, light.black
        both = [[one.expand(len(images), -1, -1, -1) for one in light] for images, light in many]
        light, black = (torch.cat(one) for one in zip(*both, strict=True))
        return _concatenated([images for images, _ in many]), light, black

    def _noise_of(self, many: _Many) -> _Computation[list[float]]:
        (found,) = yield [estimate_noise(_concatenated([image for (image,) in many]))]
        result: list[float] = found.tolist()
        return result

    def _prepare_of(self, many: _Many) -> _Computation[list[_TorchTemplates]]:
        keys, points, warps = zip(*many, strict=True)
        noise = np.array([key.noise for key in keys], np.float32)
        counts = [len(one) for one in points]
        # Points are few sizes for a device, whose graphs are recorded for each size.
        sizes = [-(-count // ROWS) * ROWS if self.computes_behind else count for count in counts]
        given = [points] if warps[0] is None else [points, warps]
        place, *warp, deviation = self._send(*(stacked(one, max(sizes)) for one in given), noise)
        images = _concatenated([key.image for key in keys])
        templates = self._key(images, place, deviation, *warp)
        (numbers,) = yield [templates.numbers]
        return [
            _TorchTemplates(Templates._make(one[k : k + 1, :size] for one in templates), numbers[k, :count].copy())
            for k, (count, size) in enumerate(zip(counts, sizes, strict=True))
        ]

    def _track_of(self, many: _Many) -> _Computation[list[arrays.Tracked]]:
        held, images, places, speeds, neighbours, starts, inverses = zip(*many, strict=True)
        templates = self._stacked_templates(held, [None] * len(many))
        if not kernels.fused_tracking_serves(templates.samples, *images):
            alone = [(*one, None) for one in zip(held, images, places, speeds, strict=True)]
            return [arrays.Tracked(one, None) for one in (yield from self._follow_of(alone))]
        frames, most = [len(one) for one in images], templates.start.shape[1]
        place, speed, start, inverse, lengths = self._send(
            *(stacked(one, most) for one in (places, speeds, starts, inverses)), np.array(frames, np.int32)
        )
        near = Neighbours(*map(_concatenated, zip(*(_padded(one, most) for one in neighbours), strict=True)))
        tracked = self._points(templates, _frame_by_frame(images), place, speed, lengths, near, start, inverse)
        copied = iter((yield tree_leaves(tracked)))
        found, after = [next(copied) for _ in Found._fields], (next(copied), next(copied))
        deformed = list(copied)
        results = []
        for b, (last, own) in enumerate(zip(frames, starts, strict=True)):
            some, count = slice(b, last * len(many), len(many)), len(own)
            of_frames = arrays.FoundPoints(*(one[some, :count] for one in found))
            corrected = [one[some, :count] for one in deformed]
            results.append(
                arrays.Tracked(
                    arrays.Followed(of_frames, *(one[b, :count] for one in after)),
                    arrays.Corrected(arrays.FoundPoints(*corrected[: len(found)]), *corrected[len(found) :]),
                )
            )
        return results

    def _follow_of(self, many: _Many) -> _Computation[list[arrays.Followed]]:
        held, images, places, speeds, rows = zip(*many, strict=True)
        counts, frames = [len(one) for one in places], [len(one) for one in images]
        templates = self._stacked_templates(held, rows)
        size = templates.start.shape[:2]
        if kernels.fused_tracking_serves(templates.samples, *images):
            return (yield from self._follow_fused(templates, images, places, speeds))
        # Concatenate the points of all recordings; a recording with fewer frames repeats its last frame until the
        # others end.
        courses = [MotionState.begin(*(stacked(one, size[1]).reshape(-1, 2) for one in (places, speeds)))]
        every = []
        for k in range(max(frames)):
            image = _concatenated([one[min(k, len(one) - 1)][None] for one in images])
            (guess,) = self._send(courses[k].expect().reshape(*size, 2))
            look = partial(self._look, image)
            first = look(templates, guess)
            found = yield first
            # This decision on the host costs no extra wait, as the host waits for the first round anyway.
            if (arrays.FoundPoints(*found).status == TrackStatus.NOT_CONVERGED).any():
                found = yield further_rounds(look, templates, first, ROUNDS - 1)
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
    ) -> _Computation[list[arrays.Followed]]:
        """Track the templates of several recordings through all frames of each in one GPU kernel launch (Triton), from
        the positions `places` and `speeds` of the points before the first frame.
        """
        from fingerflow.kernels.tensors.fused_tracking import find_templates  # imported here, as it needs Triton

        frames, views, most = [len(one) for one in images], _frame_by_frame(images), templates.start.shape[1]
        limits = rounding_variance(views), self.settings.forward_backward_limit_px, MISMATCH_SHARE
        near, pace, lengths = self._send(stacked(places, most), stacked(speeds, most), np.array(frames, np.int32))
        *found, place, speed = yield find_templates(templates, views, near, pace, None, ROUNDS, *limits, lengths)
        return [
            arrays.Followed(
                arrays.FoundPoints(*(one[:last, b, : len(own)] for one in found)),
                place[b, : len(own)],
                speed[b, : len(own)],
            )
            for b, (last, own) in enumerate(zip(frames, places, strict=True))
        ]

    def _stacked_templates(self, held: Sequence[_TorchTemplates], rows: Sequence[Array | None]) -> Templates:
        """Return the templates of B recordings, of all points or of those with the indices `rows`, padded to equal
        numbers of points and stacked along a first axis of length B.
        """
        every = [
            one.templates if some is None else one.templates.of(self._tensor(some)[None])
            for one, some in zip(held, rows, strict=True)
        ]
        if len({len(one.start[0]) for one in every}) == 1:
            return Templates._make(map(_concatenated, zip(*every, strict=True)))
        return Templates._make(
            nn.utils.rnn.pad_sequence([one[0] for one in some], True, torch.nan) for some in zip(*every, strict=True)
        )

    def _look(self, image: Tensor, templates: Templates, near: Tensor) -> Found:
        found: Found = self._track(templates, image, near)
        return found

    def _correct_of(self, many: _Many) -> _Computation[list[arrays.Corrected]]:
        starts, founds, numbers, inverses = zip(*many, strict=True)
        counts = [len(one) for one in starts]
        known = map(stacked, (starts, numbers, inverses))
        recording, *sent = self._send(_recording_of_frames(founds), *known, *_join_found(founds))
        start, number, inverse = self._for_frames(recording, sent[:3])
        corrected, *others = self._deformation(start, Found(*sent[3:]), number, inverse)
        copied = yield [*corrected, *others]
        every = copied[: len(corrected)], copied[len(corrected) :]
        return [
            arrays.Corrected(
                arrays.FoundPoints(*(one[k, :count] for one in every[0])), *(one[k, :count] for one in every[1])
            )
            for k, count in zip(parts(len(one.status) for one in founds), counts, strict=True)
        ]

    def _outliers_of(self, many: _Many) -> _Computation[list[tuple[Array, Array]]]:
        neighbours, starts, founds = zip(*many, strict=True)
        counts = [len(one) for one in starts]
        found = _join_found(founds)
        recording, place, points, deviation = self._send(
            _recording_of_frames(founds), stacked(starts), found.points, np.sqrt(found.variance)
        )
        joined = map(_concatenated, zip(*(_padded(one, max(counts)) for one in neighbours), strict=True))
        near = Neighbours(*self._for_frames(recording, joined))
        (start,) = self._for_frames(recording, [place])
        off, uncertain = yield self._agreement(near, start, points, deviation)
        return [
            (off[k, :count], uncertain[k, :count])
            for k, count in zip(parts(len(one.status) for one in founds), counts, strict=True)
        ]

    def _for_frames(self, recording: Tensor, values: Iterable[Tensor]) -> list[Tensor]:
        """Return tensors (B, N, ...) of B recordings as tensors (frames, N, ...), each repeated for the frames of its
        recording; `recording` (frames,) is the index of the recording of each frame.

        Those of a single recording stay (1, N, ...).
        """
        return [one if len(one) == 1 else one[recording] for one in values]

    def _windows_of(self, many: _Many) -> _Computation[list[Array]]:
        images, numbers, places, warps, steps = zip(*many, strict=True)
        frames = parts(len(one) for one in images)
        number = np.concatenate([one + some.start for one, some in zip(numbers, frames, strict=True)])
        which, place, warp = self._send(number, np.concatenate(places), np.concatenate(warps))
        window = self.settings.window_px
        (found,) = yield [sample_windows(_concatenated(images), which, place, warp, window, steps[0])]
        return [found[some] for some in parts(len(one) for one in places)]


def _frame_by_frame(images: Sequence[Tensor]) -> Tensor:
    """Join the images (K, 1, H, W) of B recordings so that frame k of recording b is the k B + b th; recordings of
    fewer frames are padded.
    """
    alike = len({len(one) for one in images}) == 1
    views = torch.stack(list(images), 1) if alike else nn.utils.rnn.pad_sequence(list(images))
    return views.flatten(0, 1)


def _join_found(founds: Sequence[arrays.FoundPoints]) -> arrays.FoundPoints:
    """Concatenate the tracking results of several recordings along the frames, padded to equal numbers of points."""
    if len(founds) == 1:
        return founds[0]
    most = max(one.status.shape[1] for one in founds)
    given = zip(*founds, strict=True)
    return arrays.FoundPoints(*(np.concatenate([filled(one, most, axis=1) for one in some]) for some in given))


def _recording_of_frames(founds: Sequence[arrays.FoundPoints]) -> Array:
    """Return the index (frames,) of the recording of each frame, given the tracking results of each recording."""
    return np.repeat(np.arange(len(founds)), [len(one.status) for one in founds])


def images_on(device: torch.device, frames: Array) -> Tensor:
    """Convert the images (K, H, W) of K frames to a tensor (K, 1, H, W) on a device, as `images_ahead` does."""
    return images_ahead(transfers_of(device), frames)()


def images_ahead(transfers: Transfers, frames: Array) -> Callable[[], Tensor]:
    """Begin to copy the images (K, H, W) of K frames to a device; return a function that returns them as a tensor (K,
    1, H, W) for computations launched after its call.

    It must not be written to: on the CPU it shares memory with the frames unless these are converted. uint16 becomes
    int32, with which torch can compute, and float64 becomes float32.
    """
    if frames.dtype == np.uint16:
        frames = frames.astype(np.int32)
    elif frames.dtype == np.float64:
        frames = frames.astype(np.float32)
    elif not frames.flags.writeable:
        frames = np.asarray(_DeclaredWritable(frames))
    ready = transfers.send_ahead(frames)
    return lambda: ready()[:, None]


class _DeclaredWritable:
    """Wrapper that declares a read-only array, such as a memory map, writable, so that torch does not warn of it.

    Torch warns of read-only arrays, and engines only read.
    """

    def __init__(self, array: Array) -> None:
        self._array = array  # keeps the array's memory alive as long as the pointer is used
        address = array.__array_interface__["data"][0]
        self.__array_interface__ = {**array.__array_interface__, "data": (address, False)}


def _real(array: Array) -> Array:
    """Return an array of numbers in single precision, and one of truth values as it is."""
    return array if array.dtype == bool else array.astype(np.float32, copy=False)


def _concatenated(tensors: Sequence[Tensor]) -> Tensor:
    """Concatenate the tensors of several recordings along their first axis; that of a single one is not copied."""
    return tensors[0] if len(tensors) == 1 else torch.cat(list(tensors))


def _padded(neighbours: Neighbours, points: int) -> Neighbours:
    """Pad the neighbours of N points to those of `points` points, which have none."""
    missing = points - neighbours.number.shape[-1]
    if not missing:
        return neighbours
    more = functional.pad(neighbours.offset, (0, 0, 0, missing))
    return Neighbours(
        functional.pad(neighbours.number, (0, missing)), more, functional.pad(neighbours.within, (0, missing))
    )


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
    if isinstance(argument, np.ndarray) and argument.ndim == 4 and argument.shape[1] == 1:
        return argument.shape[2:]  # of a grid of cells; arrays of points are padded
    return argument if isinstance(argument, int) else argument is None
