"""Points of the skin through all frames of the topography view."""

from collections.abc import Sequence
from typing import Any, ClassVar

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from fingerflow.errors import FingerflowError, NoRoomError
from fingerflow.graphs.detect import DetectGraph
from fingerflow.graphs.track import WARP_GAUGE_PX
from fingerflow.ops.apparent_contact import cell_of
from fingerflow.ops.cells import covered
from fingerflow.ops.contrast import stretch_contrast, subtract_background, unsharp_mask
from fingerflow.ops.templates import Found
from fingerflow.ops.tracking_limits import TrackStatus
from fingerflow.player.contract.variables import TRACKING
from fingerflow.room import size_of_results
from fingerflow.stages import plausibility
from fingerflow.stages.chosen_points import ChosenPoints, Graphs, beside, part_of
from fingerflow.stages.contact import ContactStage
from fingerflow.stages.frame_check import FrameCheckStage
from fingerflow.stages.new_skin import Known, NewSkin
from fingerflow.stages.regions import region_mask
from fingerflow.stages.series import nanmedian
from fingerflow.stages.stage import Batch, Stage, Trial

_SHARPEN_PX = 1.0  # radius of the sharpening, that of the function the lab's code calls
MOST_CHOSEN = 3  # times `tracking.points`, of points that are chosen in a recording altogether


class TrackingStage(Stage):
    """Follows points from frame to frame, in the order of time or against it.

    With keyframes every frame is compared with the first one, the template deformed by the gradient of the motion found
    so far: errors do not add up. From frame to frame they do.

    Where skin comes into contact that lay outside the region of that choice (`NewSkin`), points are chosen there too,
    in the last frame of a batch, which is their key frame; in the frames before they have the status NOT_CHOSEN_YET.
    Of a press there are none.
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
        self._detect = inputs.engine(self._detector(self._settings.points))
        self._graphs = Graphs.of(inputs, self._settings)
        self._matrix = torch.from_numpy(inputs.topography_to_contact).to(inputs.device, torch.float32)
        self._chosen: list[ChosenPoints] = []
        self._around: list[Tensor] = []  # numbers (A,) of the points before that each of these goes by
        self._density = 0.0  # points a px of the region of the first choice
        self._new_skin: NewSkin | None = None
        self._full = False  # whether no more points may be chosen
        self._skipped: list[int] = []  # frames before the points were chosen
        self._region = torch.empty(0)  # (1, 1, h, w) bool, px of the contact view: where to look for points
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
        window = self._settings.window_px
        self._region = contact.first_and_largest(window) if border else contact.largest_and_first(window)
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
        if not self._chosen:
            self._skipped.extend(indices)
            return
        self.results["status"][indices] = TrackStatus.FRAME_NOT_USABLE
        for points in self._chosen:
            points.pass_over(len(indices))

    def _step_through(self, images: Tensor, indices: NDArray[np.intp], margin: Tensor) -> None:
        every: list[Found] = []
        if not self._chosen:
            first = self._choose(images[:1], margin[:1])
            for skipped in self._skipped:
                self.results["status"][[skipped]] = TrackStatus.FRAME_NOT_USABLE
            every.append(self._go_on(self._chosen[0], images, first, _nothing(images)))
        else:
            for points, numbers in zip(self._chosen, self._around, strict=True):
                around = part_of(beside(every), numbers) if every else _nothing(images)
                every.append(self._go_on(points, images, None, around))
        found = beside(every)
        before = found.status.shape[1]
        new = self._choose_new(images[-1:], margin[-1:], Found._make(one[-1:] for one in found))
        if new is not None:
            found = beside((found, _in_last_of(len(images), new)))
        pixels, error, status = (one.cpu().numpy() for one in (found.points, found.error, found.status))
        in_contact = self._inside(margin, found.estimate) & (found.status != TrackStatus.NOT_CHOSEN_YET)
        for name, values in {
            "position": self.inputs.on_glass(pixels.astype(np.float64)),
            "position_px": pixels,
            "position_std_px": found.variance.sqrt().cpu().numpy(),
            "forward_backward_error": error,
            "status": status,
            "in_contact": in_contact.cpu().numpy(),
        }.items():
            self.results[name][indices] = values
        tracked, differs = (status[:, :before] == one for one in (TrackStatus.TRACKED, TrackStatus.WINDOW_DIFFERS))
        self._share[indices] = tracked.mean(1)
        self._differs[indices] = differs.mean(1)
        self._error[indices] = nanmedian(np.where(tracked, error[:, :before], np.nan))

    def _go_on(self, points: ChosenPoints, images: Tensor, first: Found | None, around: Found) -> Found:
        """What is found of points in these images, the `first` of which is known where they are chosen there."""
        known = [] if first is None else [first]
        rest = images[len(known) :]
        if len(rest):
            known.append(points.follow(rest, Found._make(one[len(known) :] for one in around)))
        return points.looked_at(images, Found.joined(known), around)

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

    def _detector(self, points: int) -> DetectGraph:
        return DetectGraph(points, self._settings.min_distance_px, self._settings.window_px)

    def _choose(self, image: Tensor, margin: Tensor) -> Found:
        """Chooses the points in the first frame."""
        where = self._where(image)
        found, _ = self._detect(self._view_for_choice(image), where)
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
        self._density = points.shape[1] / float(where.sum())
        cell = cell_of(self.inputs.scene.contact.gross_radius_px)
        self._new_skin = NewSkin(self.inputs.topography_to_contact, cell, self._settings.window_px)
        self._new_skin.searched.append(where[0, 0].cpu().numpy())
        self._new_skin.begin(margin[0, 0].cpu().numpy(), points[0].cpu().numpy())
        nobody = torch.zeros(0, dtype=torch.int64, device=image.device)
        return self._add(image, points, nobody, _nothing(image))

    def _add(self, image: Tensor, points: Tensor, numbers: Tensor, found: Found) -> Found:
        """Points (1, N, 2) px chosen in an image; they go by those of these numbers, `found` (1, ...) in it."""
        around = found.points[:, numbers]
        self._chosen.append(ChosenPoints(self._graphs, self._settings, image, points, around))
        self._around.append(numbers)
        return self._chosen[-1].as_chosen

    def _view_for_choice(self, image: Tensor) -> Tensor:
        return image if self._settings.points_from == "recorded" else self._enhanced(image)

    def _places(self, name: str) -> NDArray[np.float32]:
        """(N, 2) px of all points: where they are expected, or where they were chosen."""
        result: NDArray[np.float32] = torch.cat([getattr(one, name) for one in self._chosen], dim=1)[0].cpu().numpy()
        return result

    def _choose_new(self, image: Tensor, margin: Tensor, found: Found) -> Found | None:
        """Points that are chosen in new skin of an image (1, 1, h, w), where `found` (1, N) is known of the others."""
        if self._full:
            return None
        assert self._new_skin is not None
        place, total = self._places("place"), found.status.shape[1]
        choice = np.repeat(np.arange(len(self._chosen)), [len(one) for one in self._chosen])
        tracked = found.status[0] == TrackStatus.TRACKED
        known = Known(place, self._places("start"), tracked.cpu().numpy(), choice)
        region = self._new_skin.region(margin[0, 0].cpu().numpy(), known)
        if region is None:
            return None
        if (drawn := region_mask(self.inputs.scene, "topography")) is not None:
            region &= drawn
        wanted = min(round(self._density * float(region.sum())), MOST_CHOSEN * self._settings.points - total)
        if wanted < 1:
            return None
        where = torch.from_numpy(region).to(image.device)[None, None]
        corners, _ = self._detector(wanted)(self._view_for_choice(image), where)
        points = corners[:, corners[0].isfinite().all(-1)]
        if not points.shape[1] or not self._make_room(total, points.shape[1]):
            return None
        apart, _ = cKDTree(points[0].cpu().numpy()).query(place)
        near = np.flatnonzero(known.tracked & (apart <= WARP_GAUGE_PX))
        self._new_skin.searched.append(region)
        return self._add(image, points, torch.from_numpy(near).to(image.device), found)

    def _make_room(self, points: int, more: int) -> bool:
        """Lets the results grow; a warning says where they may not."""
        given = [one for stage in self.trial.planned for one in stage.gives]
        given = [one for one in given if one.unasked or one.name in self.trial.asked]
        why = ""
        if points + more == MOST_CHOSEN * self._settings.points:
            why = f"{points + more} points, {MOST_CHOSEN} times tracking.points, have been chosen"
        try:
            self.results.check_room(size_of_results(given, len(self.trial), more))
        except NoRoomError as error:
            why, more = str(error), 0
        if why:
            self._full = True
            self.warnings.append(f"no more points are chosen where skin comes into contact: {why}")
        if more:
            self.results.grow("point", points + more, {"status": TrackStatus.NOT_CHOSEN_YET})
        return more > 0

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

    def _inside(self, density_margin: Tensor, points: Tensor) -> Tensor:
        """Whether the gross contact (`Contact.density_margin`) covers points (n, P, 2) of its view, (n, P)."""
        # Components before points: torch is slow where the last axis is short.
        x, y = (self._matrix[:, :2] @ points.mT + self._matrix[:, 2:]).unbind(1)
        return covered(density_margin, x, y, cell_of(self.inputs.scene.contact.gross_radius_px))


def _nothing(images: Tensor) -> Found:
    """Of no points in images (n, 1, h, w)."""
    none = torch.zeros(len(images), 0, device=images.device, dtype=torch.float32)
    place = none[..., None].expand(-1, -1, 2)
    return Found(place, none, place[..., None].expand(-1, -1, -1, 2), none.to(torch.uint8), place)


def _in_last_of(frames: int, chosen: Found) -> Found:
    """Points that are `chosen` (1, N) in the last of so many frames, in all of these."""
    points, error, covariance = (torch.full_like(one, torch.nan) for one in chosen[:3])
    status = torch.full_like(chosen.status, int(TrackStatus.NOT_CHOSEN_YET))
    before = Found(points, error, covariance, status, chosen.estimate)
    return Found.joined([before] * (frames - 1) + [chosen])
