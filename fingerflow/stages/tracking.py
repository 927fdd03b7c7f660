"""Points of the skin through all frames of the topography view."""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, ClassVar

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.errors import FingerflowError
from fingerflow.graphs.detect import DetectGraph
from fingerflow.graphs.key import KeyGraph
from fingerflow.graphs.track import (
    RENEWAL_PX,
    WARP_GAUGE_PX,
    AgreementGraph,
    DeformationGraph,
    TrackGraph,
    merged,
)
from fingerflow.ops.apparent_contact import cell_of
from fingerflow.ops.cells import covered
from fingerflow.ops.contrast import stretch_contrast, subtract_background, unsharp_mask
from fingerflow.ops.following import Followed, expected, follow_templates
from fingerflow.ops.noise import estimate_noise
from fingerflow.ops.outliers import Neighbours, find_neighbours
from fingerflow.ops.templates import Found, Templates, first_of, inverse_2x2
from fingerflow.ops.tracking import ROUNDS, search_lost
from fingerflow.ops.tracking_limits import TrackStatus
from fingerflow.player.contract.variables import TRACKING
from fingerflow.stages import plausibility
from fingerflow.stages.contact import ContactStage
from fingerflow.stages.frame_check import FrameCheckStage
from fingerflow.stages.regions import region_mask
from fingerflow.stages.second_look import SecondLook
from fingerflow.stages.series import nanmedian
from fingerflow.stages.stage import Batch, Stage, Trial

_FAR, _UNSURE = 5.0, 3.0  # times the usual distance and deviation
_SHARPEN_PX = 1.0  # radius of the sharpening, that of the function the lab's code calls
MOST_AT_ONCE = 8  # frames that are followed before deformations are looked at
_FASTEST_PX = 0.2  # that the edges of windows may change by until then


class TrackingStage(Stage):
    """Follows points from frame to frame, in the order of time or against it.

    With keyframes every frame is compared with the first one, the template deformed by the gradient of the motion found
    so far: errors do not add up. From frame to frame they do.
    """

    name = "tracking"
    gives = TRACKING
    needs = ("views.topography",)
    beside = (ContactStage,)
    after: ClassVar[tuple[type[Stage], ...]] = (FrameCheckStage,)
    reads_frames = True
    settings: ClassVar[tuple[str, ...]] = (
        *("tracking", "views.topography", "stream.region", "background", "contact.gross_radius_px"),
        *("calibration.mm_per_px", "calibration.topography_to_contact", "recording.first_frame"),
    )
    restored = True

    def __init__(self, trial: Trial) -> None:
        super().__init__(trial)
        inputs, view = self.inputs, self.inputs.scene.views.topography
        assert view is not None
        self._view = view
        self._settings = inputs.scene.tracking
        self._detect = inputs.engine(
            DetectGraph(self._settings.points, self._settings.min_distance_px, self._settings.window_px)
        )
        self._keys = inputs.engine(KeyGraph(self._settings.window_px, self._settings.gain_offset))
        self._track = inputs.engine(TrackGraph(self._settings.forward_backward_limit_px))
        self._agreement = inputs.engine(AgreementGraph())
        self._deformation = inputs.engine(DeformationGraph(self._settings.window_px))
        self._matrix = torch.from_numpy(inputs.topography_to_contact).to(inputs.device, torch.float32)
        self._key: Tensor | None = None  # the image that the templates are from
        self._noise = torch.empty(0)
        self._templates: Templates | None = None
        self._place = self._speed = torch.empty(0)
        self._warp = self._inverse_warp = torch.empty(0)  # as the templates have it, (1, N, 2, 2)
        self._neighbours: Neighbours | None = None
        self._to_renew: tuple[Tensor, Tensor] | None = (
            None  # numbers (L,) of templates, and for which warp (1, L, 2, 2)
        )
        self._at_once = MOST_AT_ONCE if self._settings.template == "keyframe" else 1  # frames
        self._followed = self._looked = 1  # frames since the points were chosen, and when templates were looked at
        self._walked: Tensor | float = 0.0  # variance that has come together from frame to frame
        self._skipped: list[int] = []  # frames before the points were chosen
        self._region = torch.empty(0)  # (1, 1, h, w) bool, px of the contact view: where to look for points
        self._second: SecondLook | None = None
        self._share, self._error, self._differs = np.full((3, len(trial)), np.nan)

    @classmethod
    def depends_on(cls, planned: Sequence[type[Stage]]) -> Any:
        return any(stage.follows_border for stage in planned)

    @property
    def backward(self) -> bool:
        return self._settings.direction == "backward"

    def begin(self) -> None:
        """Finds out where skin touches; where none does there is none to follow, which a warning says."""
        contact = self.trial.stage(ContactStage)
        self._usable = self.trial.stage(FrameCheckStage).usable
        border = self.depends_on(self.trial.planned)
        self._region = contact.first_and_largest(self._settings.window_px) if border else contact.largest()
        if not self._region.any():
            self.warnings.append(
                f"no contact was found in frame {contact.reference_frame + self.inputs.scene.recording.first_frame}, "
                f"where most of it was expected: there are no points and no deformation"
            )
            self._create(0)

    def step(self, batch: Batch) -> None:
        """Tracks through these frames, in the order given; those that are not usable are passed over."""
        if "position" in self.results and not self.results["position"].shape[1]:
            return
        assert batch.frames is not None
        margin = batch.of(ContactStage).density_margin
        images = self.inputs.view(batch.frames, self._view)
        numbers = np.arange(len(images))
        for some in np.split(numbers, np.flatnonzero(np.diff(self._usable[batch.indices])) + 1):
            indices = batch.indices[some]
            if self._usable[indices[0]]:
                self._step_through(images[some[0] : some[-1] + 1], indices, margin[some[0] : some[-1] + 1])
            else:
                self._pass_over(indices)

    def _pass_over(self, indices: NDArray[np.intp]) -> None:
        """Frames that tell nothing: points are expected on where their speed leads."""
        if self._key is None:
            self._skipped.extend(indices)
            return
        self.results["status"][indices] = TrackStatus.FRAME_NOT_USABLE
        self._place = self._place + len(indices) * self._speed

    def _step_through(self, images: Tensor, indices: NDArray[np.intp], margin: Tensor) -> None:
        steps, done = [], 0
        if self._key is None:
            steps.append(self._choose(images[:1]))
            for skipped in self._skipped:
                self.results["status"][[skipped]] = TrackStatus.FRAME_NOT_USABLE
            done = 1
        while done < len(images):
            until_look = MOST_AT_ONCE - self._followed % MOST_AT_ONCE
            step = self._step(images[done : done + min(self._at_once, until_look)])
            steps.append(step)
            done += len(step.status)
        found = Found.joined(steps)
        assert self._second is not None
        differs = (found.status == TrackStatus.TRACKED) & self._second.failed(images, found.points, found.status)
        variance = torch.where(differs, torch.nan, self._since_start(found.variance))
        found = found._replace(
            points=torch.where(differs[..., None], torch.nan, found.points),
            status=torch.where(differs, int(TrackStatus.WINDOW_DIFFERS), found.status).to(found.status.dtype),
        )
        pixels, error, status = (one.cpu().numpy() for one in (found.points, found.error, found.status))
        in_contact = self._inside(margin, found.estimate)
        for name, values in {
            "position": self.inputs.on_glass(pixels.astype(np.float64)),
            "position_px": pixels,
            "position_std_px": variance.sqrt().cpu().numpy(),
            "forward_backward_error": error,
            "status": status,
            "in_contact": in_contact.cpu().numpy(),
        }.items():
            self.results[name][indices] = values
        tracked = status == TrackStatus.TRACKED
        self._share[indices] = tracked.mean(1)
        self._differs[indices] = differs.double().mean(1).cpu()
        self._error[indices] = nanmedian(np.where(tracked, error, np.nan))

    def finish(self) -> None:
        first_frame = self.inputs.scene.recording.first_frame
        self.warnings.extend(plausibility.of_tracking(self._share, first_frame))
        self.warnings.extend(plausibility.of_windows(self._differs, first_frame))
        self.results.put("tracked_share", self._share)
        self.results.put("window_differs_share", self._differs)
        self.results.put("forward_backward_median", self._error)

    def _create(self, points: int) -> None:
        for variable in TRACKING:
            if "point" in variable.dims:
                self.results.create(variable.name, point=points)

    def _since_start(self, variance: Tensor) -> Tensor:
        """Variance (n, N) of positions relative to the skin that was chosen; from frame to frame those of all steps."""
        if self._settings.template == "keyframe":
            return variance
        walked = self._walked + variance.nan_to_num(0.0).cumsum(0)
        self._walked = walked[-1:]
        return walked + 0 * variance

    def _step(self, images: Tensor) -> Found:
        """Finds the points in the next images (n, 1, h, w); estimates are where points are or were last."""
        assert self._templates is not None
        before = self._place
        followed = self._follow(self._templates, images, self._place, self._speed)
        if self._settings.search_px and (followed.found.status >= TrackStatus.NOT_CONVERGED).any():
            followed = self._search(images, followed)
        found, self._place, self._speed = followed
        if self._settings.template == "keyframe":
            start = self._templates.start
            deform = partial(self._deformation, start, numbers=self._templates.numbers, inverse_warp=self._inverse_warp)
            deformed = deform(found=found)
            if len(suspect := _may_disagree(found, deformed.expected)):
                some = Found._make(one[suspect] for one in found)
                judged = self._agreement(self._neighbours, start, some)
                if not torch.equal(judged.status, some.status):
                    found = Found._make(one.index_copy(0, suspect, new) for one, new in zip(found, judged, strict=True))
                    deformed = deform(found=found)
            found = deformed.found
            # One that is lost, or elsewhere, is looked for where its neighbours are.
            astray = (found.status[-1:] != TrackStatus.TRACKED)[..., None] & deformed.expected[-1:].isfinite()
            self._place = torch.where(astray, deformed.expected[-1:], self._place)
            self._speed = torch.where(astray, 0.0, self._speed)
            self._followed += len(images)
            if self._at_once < MOST_AT_ONCE or self._followed % MOST_AT_ONCE == 0:
                self._look_at_templates(deformed.warp[-1:], deformed.shift[-1:])
        else:
            self._prepare(images[-1:], found.points)
        return found._replace(estimate=_last_seen(found.points, before))

    def _follow(self, templates: Templates, images: Tensor, place: Tensor, speed: Tensor) -> Followed:
        limit = self._settings.forward_backward_limit_px
        return follow_templates(
            self._track, templates, images, place, speed, rounds=ROUNDS, forward_backward_limit=limit
        )

    def _search(self, images: Tensor, followed: Followed) -> Followed:
        """The points that get lost on the way, followed once more, one frame after the other, with a search."""
        assert self._templates is not None
        assert self._key is not None
        chosen = (followed.found.status >= TrackStatus.NOT_CONVERGED).any(0).nonzero().squeeze(1)
        templates = self._templates.of(chosen[None])
        place, speed = self._place[:, chosen], self._speed[:, chosen]
        seen = torch.ones_like(place[..., :1], dtype=torch.bool)
        reach = (self._settings.search_px, self._settings.forward_backward_limit_px)
        every = []
        for image in images.split(1):
            one = self._follow(templates, image, place, speed).found
            searched = search_lost(self._track, self._key, image, templates, one, place + speed, *reach)
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
        assert self._templates is not None
        much = shift > RENEWAL_PX
        if self._to_renew is not None:
            chosen, known = self._to_renew
            self._renew(chosen, known)
            much = much.index_fill(1, chosen, False)
        half, frames = self._settings.window_px // 2, self._followed - self._looked
        fastest = half * float((warp - self._warp).flatten(-2).norm(dim=-1).nanquantile(0.95)) / frames
        self._at_once = 2 ** int(math.log2(min(max(_FASTEST_PX / max(fastest, 1e-9), 1), MOST_AT_ONCE)))
        self._warp, self._looked = warp, self._followed
        changed = first_of(much, exactly=self._templates.pixels is None)[0] if much.any() else None
        self._to_renew = None if changed is None else (changed, warp[:, changed])
        if self._to_renew is not None and self._at_once < MOST_AT_ONCE:
            self._renew(*self._to_renew)
            self._to_renew = None

    def _renew(self, chosen: Tensor, warp: Tensor) -> None:
        assert self._templates is not None
        assert self._key is not None
        renewed = self._templates_of(self._key, self._templates.start[:, chosen], warp)
        self._templates = merged(self._templates, renewed, chosen)
        self._inverse_warp = self._inverse_warp.index_copy(1, chosen, inverse_2x2(warp))

    def _choose(self, image: Tensor) -> Found:
        """Chooses the points in the first frame."""
        view = image if self._settings.points_from == "recorded" else self._enhanced(image)
        where = self._where(image)
        found, _ = self._detect(view, where)
        points = found[:, found[0].isfinite().all(-1)]
        if points.shape[1] < 3:
            raise FingerflowError(
                f"{self.inputs.recording.path}: {points.shape[1]} points with texture were found in the "
                f"contact region of the topographic view, at least 3 are needed. Check [views.topography] and its "
                f"region, [stream] region, the calibration and the focus."
            )
        asked, apart = self._settings.points, self._settings.min_distance_px
        self.warnings.extend(plausibility.of_points(points.shape[1], asked, apart, int(where.sum())))
        self._create(points.shape[1])
        self._second = SecondLook(image, points[0], self._settings.window_px)
        self._noise = estimate_noise(image)
        self._place, self._speed = points, torch.zeros_like(points)
        unchanged = torch.eye(2, dtype=points.dtype, device=image.device)
        self._warp = self._inverse_warp = unchanged.expand(1, points.shape[1], 2, 2)
        self._neighbours = find_neighbours(points, WARP_GAUGE_PX)
        self._prepare(image, points)
        exact = torch.zeros_like(points[..., 0])
        return Found(points, exact, exact[..., None, None].expand(-1, -1, 2, 2), exact.to(torch.uint8), points)

    def _enhanced(self, image: Tensor) -> Tensor:
        """The picture in which Willemet et al. (2021, figure S3 B) choose points. It changes little: on the shipped
        press points so chosen are 0.0274 px off in the last frame, others 0.0282, and as many lie on dust.
        """
        skin = subtract_background(image, self.inputs.reference(self._view))
        return unsharp_mask(stretch_contrast(skin), _SHARPEN_PX)

    def _where(self, image: Tensor) -> Tensor:
        """(1, 1, H, W) bool: the region that the scene draws in the topography view; or where in the first frame
        (1, 1, H, W) of a stream skin is expected to touch: so both have the same points. Else, and of a stream's region
        where the last frame comes first, all that touches at some time.
        """
        drawn = region_mask(self.inputs.scene, "topography")
        if drawn is not None:
            return torch.from_numpy(drawn).to(image.device)[None, None]
        stated = self.inputs.scene.stream.region
        if stated is not None and self._settings.direction == "forward":
            mask = torch.zeros_like(image, dtype=torch.bool)
            stated.crop(mask)[...] = True
            return mask
        region = cv2.warpAffine(
            self._region[0, 0].cpu().numpy().astype(np.uint8),
            self.inputs.topography_to_contact,
            (image.shape[3], image.shape[2]),
            flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
        )
        return torch.from_numpy(region).to(image.device)[None, None] > 0

    def _prepare(self, image: Tensor, points: Tensor) -> None:
        # A copy: the image is a part of a batch of frames, which it would keep in memory.
        self._key = image.clone()
        self._templates = self._templates_of(self._key, points, None)

    def _templates_of(self, key: Tensor, points: Tensor, warp: Tensor | None) -> Templates:
        result: Templates = self._keys(key, points, self._noise, warp)
        return result

    def _inside(self, density_margin: Tensor, points: Tensor) -> Tensor:
        """Whether the gross contact (`Contact.density_margin`) covers points (n, P, 2) of its view, (n, P)."""
        x, y = (points @ self._matrix[:, :2].T + self._matrix[:, 2]).unbind(-1)
        return covered(density_margin, x, y, cell_of(self.inputs.scene.contact.gross_radius_px))


def _may_disagree(found: Found, expected: Tensor) -> Tensor:
    """Numbers (k,) of the frames in which a point is far enough from where its neighbours expect it, or uncertain
    enough, to be looked at: what `find_outliers` marks is further off, and mostly there is nothing.
    """
    variance = found.variance
    off = (found.points - expected).square().sum(-1) / variance
    usual, usual_variance = (one.nanmedian(1, keepdim=True).values for one in (off, variance))
    return ((off > _FAR**2 * usual) | (variance > _UNSURE**2 * usual_variance)).any(1).nonzero().squeeze(1)


def _last_seen(points: Tensor, before: Tensor) -> Tensor:
    """(n, N, 2): points, and where one is lost its last place, or that of ``before`` (1, N, 2)."""
    places = []
    for one in points.split(1):
        before = torch.where(one.isfinite(), one, before)
        places.append(before)
    return torch.cat(places)
