"""Points that were chosen in one picture, followed through the frames after it."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from fingerflow.graphs.key import KeyGraph
from fingerflow.graphs.track import (
    RENEWAL_PX,
    WARP_GAUGE_PX,
    AgreementGraph,
    DeformationGraph,
    TrackGraph,
)
from fingerflow.ops.following import Followed, expected, follow_templates
from fingerflow.ops.looking import looks
from fingerflow.ops.noise import estimate_noise
from fingerflow.ops.outliers import find_neighbours
from fingerflow.ops.templates import Found, Templates, first_of, inverse_2x2
from fingerflow.ops.tensors import finite
from fingerflow.ops.tracking import ROUNDS, search_lost
from fingerflow.ops.tracking_limits import Number, TrackStatus
from fingerflow.player.contract.pace import MOST_FRAMES, frames_to_next_look
from fingerflow.scene import TrackingSettings
from fingerflow.stages.inputs import Inputs
from fingerflow.stages.second_look import SecondLook

_FAR, _UNSURE = 5.0, 3.0  # times the usual distance and deviation


@dataclass(frozen=True)
class Graphs:
    """What points of all key frames are followed by."""

    keys: KeyGraph
    track: TrackGraph
    agreement: AgreementGraph
    deformation: DeformationGraph

    @classmethod
    def of(cls, inputs: Inputs, settings: TrackingSettings) -> "Graphs":
        """By the engine of a trial."""
        return cls(
            inputs.engine(KeyGraph(settings.window_px, settings.gain_offset)),
            inputs.engine(TrackGraph(settings.forward_backward_limit_px)),
            inputs.engine(AgreementGraph()),
            inputs.engine(DeformationGraph(settings.window_px)),
        )


class ChosenPoints:
    """N points with the picture they were chosen in, their key frame.

    How the skin deforms around them is learnt from them and from A points that were chosen before, which are known in
    the key frame too: those of a narrow band alone would say little.

    Attributes:
        place: (1, N, 2) px, where points are, or are expected.
    """

    def __init__(
        self, graphs: Graphs, settings: TrackingSettings, image: Tensor, points: Tensor, around: Tensor
    ) -> None:
        """`image` (1, 1, h, w), `points` (1, N, 2) and `around` (1, A, 2) px in it."""
        self._graphs, self._settings = graphs, settings
        self._second = SecondLook(image, points[0], settings.window_px, around[0])
        self._noise = estimate_noise(image)
        self.place, self._speed = points, torch.zeros_like(points)
        self._start = torch.cat((points, around), dim=1)
        unchanged = torch.eye(2, dtype=points.dtype, device=image.device)
        # As the templates have it, (1, N, 2, 2).
        self._warp = self._inverse_warp = unchanged.expand(1, points.shape[1], 2, 2)
        self._neighbours = find_neighbours(self._start, WARP_GAUGE_PX)
        # Numbers (L,) of templates, and for which warp (1, L, 2, 2).
        self._to_renew: tuple[Tensor, Tensor] | None = None
        self._at_once = MOST_FRAMES if settings.template == "keyframe" else 1  # frames
        # Frames since the points were chosen, and when templates were looked at.
        self._followed = self._looked = 1
        self._walked: Tensor | float = 0.0  # variance that has come together from frame to frame
        # A copy: the image is a part of a batch of frames, which it would keep in memory.
        self._key = image.clone()
        self._templates: Templates = self._templates_of(self._key, points, None)

    @property
    def start(self) -> Tensor:
        """(1, N, 2) px, where they were chosen."""
        return self._start[:, : len(self)]

    def __len__(self) -> int:
        return self.place.shape[1]

    @property
    def as_chosen(self) -> Found:
        """What was found (1, N) of them in their own key frame."""
        points = self.start
        exact = torch.zeros_like(points[..., 0])
        return Found(points, exact, exact[..., None, None].expand(-1, -1, 2, 2), exact.to(torch.uint8), points)

    def pass_over(self, frames: int) -> None:
        """Frames that tell nothing: points are expected on where their speed leads."""
        self.place = self.place + frames * self._speed

    def follow(self, images: Tensor, around: Found) -> Found:
        """What is found (n, N) of them in the next images (n, 1, h, w), where that of the points around is (n, A)."""
        steps, done = [], 0
        while done < len(images):
            until_look = MOST_FRAMES - self._followed % MOST_FRAMES
            now = slice(done, done + min(self._at_once, until_look))
            step = self._step(images[now], Found._make(one[now] for one in around))
            steps.append(step)
            done += len(step.status)
        return Found.joined(steps)

    def looked_at(self, images: Tensor, found: Found, around: Found) -> Found:
        """The same after a second look, with the variance since the key frame; all NaN of points that fail."""
        failed = self._second.failed(images, found.points, found.status, around.points[-1])
        differs = (found.status == TrackStatus.TRACKED) & failed
        if self._settings.template == "previous":
            each = torch.eye(2, dtype=found.covariance.dtype, device=found.covariance.device)
            found = found._replace(covariance=self._since_start(found.variance)[..., None, None] * each)
        if looks(differs) and not differs.any():
            return found
        return found._replace(
            points=torch.where(differs[..., None], torch.nan, found.points),
            covariance=torch.where(differs[..., None, None], torch.nan, found.covariance),
            status=torch.where(differs, int(TrackStatus.WINDOW_DIFFERS), found.status).to(found.status.dtype),
        )

    def _since_start(self, variance: Tensor) -> Tensor:
        """Variance (n, N) of positions relative to the skin that was chosen, from frame to frame that of all steps."""
        walked = self._walked + variance.nan_to_num(0.0).cumsum(0)
        self._walked = walked[-1:]
        return walked + 0 * variance

    def _step(self, images: Tensor, around: Found) -> Found:
        """Finds the points in the next images (n, 1, h, w); estimates are where points are or were last."""
        before = self.place
        followed = self._follow(self._templates, images, self.place, self._speed)
        if self._settings.search_px and (followed.found.status >= TrackStatus.NOT_CONVERGED).any():
            followed = self._search(images, followed)
        found, self.place, self._speed = followed
        if self._settings.template == "keyframe":
            found = beside((found, around))
            numbers, inverse_warp = self._known_of_templates(around)
            deform = partial(self._graphs.deformation, self._start, numbers=numbers, inverse_warp=inverse_warp)
            deformed = deform(found=found)
            if len(suspect := _may_disagree(found, deformed.expected)):
                some = Found._make(one[suspect] for one in found)
                judged = self._graphs.agreement(self._neighbours, self._start, some)
                if not torch.equal(judged.status, some.status):
                    found = Found._make(one.index_copy(0, suspect, new) for one, new in zip(found, judged, strict=True))
                    deformed = deform(found=found)
            found = part_of(deformed.found, slice(len(self)))
            warp, shift, places = (one[-1:, : len(self)] for one in deformed[1:])
            # One that is lost, or elsewhere, is looked for where its neighbours are.
            astray = (found.status[-1:] != TrackStatus.TRACKED)[..., None] & places.isfinite()
            self.place = torch.where(astray, places, self.place)
            self._speed = torch.where(astray, 0.0, self._speed)
            self._followed += len(images)
            if self._at_once < MOST_FRAMES or self._followed % MOST_FRAMES == 0:
                self._look_at_templates(warp, shift)
        else:
            self._key = images[-1:].clone()
            self._templates = self._templates_of(self._key, found.points, None)
        return found._replace(estimate=_last_seen(found.points, before))

    def _known_of_templates(self, around: Found) -> tuple[Tensor, Tensor]:
        """`Templates.numbers` and F_0^-1 of (1, N + A) points; of those around nothing, with unit covariance."""
        numbers = self._templates.numbers
        if not around.points.shape[1]:
            return numbers, self._inverse_warp
        none = torch.zeros_like(numbers[:, :1])
        none[..., Number.COVARIANCE_XX] = 1.0
        unchanged = torch.eye(2, dtype=numbers.dtype, device=numbers.device).expand(1, 1, 2, 2)
        others = around.points.shape[1]
        return (
            torch.cat((numbers, none.expand(-1, others, -1)), dim=1),
            torch.cat((self._inverse_warp, unchanged.expand(-1, others, -1, -1)), dim=1),
        )

    def _follow(self, templates: Templates, images: Tensor, place: Tensor, speed: Tensor) -> Followed:
        limit = self._settings.forward_backward_limit_px
        return follow_templates(
            self._graphs.track, templates, images, place, speed, rounds=ROUNDS, forward_backward_limit=limit
        )

    def _search(self, images: Tensor, followed: Followed) -> Followed:
        """The points that get lost on the way, followed once more, one frame after the other, with a search."""
        chosen = (followed.found.status >= TrackStatus.NOT_CONVERGED).any(0).nonzero().squeeze(1)
        templates = self._templates.of(chosen[None])
        place, speed = self.place[:, chosen], self._speed[:, chosen]
        seen = torch.ones_like(place[..., :1], dtype=torch.bool)
        reach = (self._settings.search_px, self._settings.forward_backward_limit_px)
        every = []
        for image in images.split(1):
            one = self._follow(templates, image, place, speed).found
            searched = search_lost(self._graphs.track, self._key, image, templates, one, place + speed, *reach)
            every.append(searched)
            # What a search has found is no motion: it may have been a jolt.
            seen = seen & (one.status == TrackStatus.TRACKED)[..., None]
            place, speed, seen = expected(place, speed, seen, searched)
        again = Found.joined(every)
        found = Found(*[old.index_copy(1, chosen, new) for old, new in zip(followed.found, again, strict=True)])
        return Followed(found, followed.place.index_copy(1, chosen, place), followed.speed.index_copy(1, chosen, speed))

    def _look_at_templates(self, warp: Tensor, shift: Tensor) -> None:
        """Finds the templates whose windows have changed by more than a part of a pixel at their edge.

        They are prepared anew for eight frames later, as in a stream, which prepares them meanwhile; where the skin
        deforms so fast that others would change by as much until then, at once, and fewer frames are followed at a
        time.
        """
        much = shift > RENEWAL_PX
        if self._to_renew is not None:
            chosen, known = self._to_renew
            self._renew(chosen, known)
            much = much.index_fill(1, chosen, False)
        half, frames = self._settings.window_px // 2, self._followed - self._looked
        fastest = half * float((warp - self._warp).flatten(-2).norm(dim=-1).nanquantile(0.95)) / frames
        self._at_once = frames_to_next_look(fastest)
        self._warp, self._looked = warp, self._followed
        changed = first_of(much, exactly=self._templates.pixels is None)[0] if much.any() else None
        self._to_renew = None if changed is None else (changed, warp[:, changed])
        if self._to_renew is not None and self._at_once < MOST_FRAMES:
            self._renew(*self._to_renew)
            self._to_renew = None

    def _renew(self, chosen: Tensor, warp: Tensor) -> None:
        renewed = self._templates_of(self._key, self._templates.start[:, chosen], warp)
        for old, new in zip(self._templates, renewed, strict=True):
            if old is not None and new is not None:
                old.index_copy_(1, chosen, new)  # in place: a few are renewed, and all are megabytes
        self._inverse_warp = self._inverse_warp.index_copy(1, chosen, inverse_2x2(warp))

    def _templates_of(self, key: Tensor, points: Tensor, warp: Tensor | None) -> Templates:
        result: Templates = self._graphs.keys(key, points, self._noise, warp)
        return result


def part_of(found: Found, points: "slice | Tensor") -> Found:
    """What was found (n, L, ...) of some points."""
    return Found._make(one[:, points] for one in found)


def beside(parts: Iterable[Found]) -> Found:
    """What was found of other points in the same frames, side by side."""
    every = list(parts)
    some = [one for one in every if one.status.shape[1]] or every[:1]
    return some[0] if len(some) == 1 else Found._make(torch.cat(one, dim=1) for one in zip(*some, strict=True))


def _may_disagree(found: Found, expected: Tensor) -> Tensor:
    """Numbers (k,) of the frames in which a point is far enough from where its neighbours expect it, or uncertain
    enough, to be looked at: what `find_outliers` marks is further off, and mostly there is nothing.
    """
    variance = found.variance
    x, y = (found.points - expected).unbind(-1)
    off = (x * x + y * y) / variance
    usual, usual_variance = (one.nanmedian(1, keepdim=True).values for one in (off, variance))
    return ((off > _FAR**2 * usual) | (variance > _UNSURE**2 * usual_variance)).any(1).nonzero().squeeze(1)


def _last_seen(points: Tensor, before: Tensor) -> Tensor:
    """(n, N, 2): points, and where one is lost its last place, or that of ``before`` (1, N, 2)."""
    places = []
    for one, known in zip(points.split(1), finite(points).split(1), strict=True):
        before = torch.where(known, one, before)
        places.append(before)
    return torch.cat(places)
