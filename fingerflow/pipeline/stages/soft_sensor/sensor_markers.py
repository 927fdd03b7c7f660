"""Markers of a soft sensor: detected in every frame, and matched to the markers in the frame at rest."""

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.errors import FingerflowError
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.ops.markers.marker_matching import Ties, match_markers, tie_neighbours
from fingerflow.ops.markers.markers import MarkerLook, detect_markers, measure_markers
from fingerflow.pipeline.stages.soft_sensor.rest import find_rest
from fingerflow.pipeline.stages.stage import Batch, RunContext, Stage

_LOOKS = 8  # number of sampled frames in which the appearance of the markers is measured
_GAUGE_SPACINGS = 3.0  # spacings, gauge length within which a marker of a square lattice has eight neighbours
_STEEPEST = 0.6  # largest median displacement gradient to the neighbours; with a larger one the match is another marker
_SEEN_OFTEN = 3  # least number of frames in which a marker that is out of view at rest must be detected
_SAME = 0.4  # spacings, distance within which inferred rest positions belong to one marker


class Seen(NamedTuple):
    """Markers detected in one frame: positions (px), covariances (px^2), and distances (px) between each position and
    the one found at a coarser image scale.
    """

    points: Tensor
    covariance: Tensor
    disagreement: Tensor


class MarkerStage(Stage):
    """Stage that detects the markers in each frame independently, and matches them to the markers in the frame at rest.

    Matching uses only lists of positions. It goes forward and backward in time from the frame at rest, which need not
    be the first one.

    Attributes:
        look: appearance of the markers.
        found: (M, 2) px for each frame, all detected markers, unordered.
        rest_frame: frame in which the gel is at rest.
        at_rest: (frames,) bool, frames that look like it.
        rest: (N, 2) px, positions at rest; NaN for markers that are cut by the border or out of view at rest.
        spacing: of the markers, px.
        points: (frames, N, 2) px, NaN where the status is not TRACKED.
        covariance: (frames, N, 2, 2) px^2.
        status: (frames, N) `TrackStatus`.
    """

    name = "markers"
    gives = ()
    needs = ("soft_sensor",)
    reads_frames = True
    settings = (
        *("views.camera", "tracking.forward_backward_limit_px", "fields.gauge_length_mm"),
        *("calibration.mm_per_px", "recording.first_frame"),
    )

    look: MarkerLook
    found: list[Tensor]
    rest_frame: int
    at_rest: NDArray[np.bool_]
    rest: NDArray[np.float64]
    spacing: float
    points: NDArray[np.float64]
    covariance: NDArray[np.float64]
    status: NDArray[np.uint8]

    def __init__(self, trial: RunContext) -> None:
        super().__init__(trial)
        self._view = self.inputs.scene.views["camera"]
        self._seen: list[Seen] = []
        self._limit = self.inputs.scene.tracking.forward_backward_limit_px

    def begin(self) -> None:
        """Measure size and polarity of the markers. Raises FingerflowError where no frame shows any."""
        count = len(self.trial)
        looks = np.unique(np.linspace(0, count - 1, min(count, _LOOKS)).round().astype(int))
        views = [self.inputs.view(self.inputs.recording[[int(k)]].read(), self._view) for k in looks]
        found = sorted(look for view in views if (look := measure_markers(view)) is not None)
        if not found:
            raise FingerflowError(
                f"{self.inputs.recording.path}: no printed markers were found: in none of {len(looks)} frames do at "
                f"least four dark or bright dots of one size stand out. Check [views.camera]; for texture use kind = "
                f'"single_view"'
            )
        self.look = found[len(found) // 2]

    def step(self, batch: Batch) -> None:
        assert batch.frames is not None
        for frame in self.inputs.view(batch.frames, self._view).split(1):
            self.take(self.see(frame))

    def see(self, frame: Tensor) -> Seen:
        """Detect the markers in one frame (1, 1, h, w) of the view, and return their positions and covariances."""
        markers = detect_markers(frame, self.look)
        known = markers.points[0].isfinite().all(-1)
        parts = (markers.points, markers.covariance, markers.disagreement)
        return Seen(*(one[0, known].double().cpu() for one in parts))

    def take(self, seen: Seen) -> None:
        """Store the markers that `see` has detected in the next frame."""
        self._seen.append(seen)

    def finish(self) -> None:
        """Find the frame in which the gel is at rest, and match the markers in all frames to the markers in that frame.

        Raises FingerflowError where fewer than 3 markers are detected in that frame.
        """
        found = find_rest([seen.points.numpy() for seen in self._seen])
        self.rest_frame, self.at_rest = found.frame, found.alike
        reference = self._seen[self.rest_frame].points
        if len(reference) < 3:
            raise FingerflowError(
                f"{self.inputs.recording.path}: {len(reference)} markers are in frame {self._number(self.rest_frame)}, "
                f"where the gel is at rest; at least 3 are needed. Check [views.camera]"
            )
        cut = self._are_cut(reference)
        ties = tie_neighbours(reference)
        numbers = self._follow(reference, ties)
        more = self._infer_entering_markers(reference, numbers, ties.spacing)
        if len(more):
            reference = torch.cat((reference, more))
            cut = torch.cat((cut, torch.ones(len(more), dtype=torch.bool)))
            ties = tie_neighbours(reference)
            numbers = self._follow(reference, ties)
        self.spacing = ties.spacing
        self.rest = torch.where(cut[:, None], torch.nan, reference).numpy()
        self._keep(reference, ties, numbers)
        self._say_what_was_taken()
        self.found = [seen.points for seen in self._seen]
        self._seen.clear()

    def _follow(self, reference: Tensor, ties: Ties) -> Tensor:
        """Match N markers with rest positions `reference` (N, 2) px and neighbour pairs `ties` to the detections in
        every frame; return the indices (frames, N) of the detections, -1 if not detected.
        """
        numbers = torch.full((len(self._seen), len(reference)), -1)
        for frames in (range(self.rest_frame, len(self._seen)), range(self.rest_frame, -1, -1)):
            moved = torch.zeros_like(reference)
            for frame in frames:
                points = self._seen[frame].points
                numbers[frame] = match_markers(reference, ties, reference + moved, points)
                seen = numbers[frame] >= 0
                if seen.any():
                    moved[seen] = points[numbers[frame][seen]] - reference[seen]
                    # Assume that an undetected marker moves with its nearest neighbour.
                    nearest = torch.cdist(reference[~seen], reference[seen]).argmin(1)
                    moved[~seen] = moved[seen][nearest]
        return numbers

    def _infer_entering_markers(self, reference: Tensor, numbers: Tensor, spacing: float) -> Tensor:
        """Infer the rest positions (K, 2) px of markers that lie outside the view at rest but enter it later, from
        their detections and the displacement of the nearest matched marker.
        """
        inferred = []
        for seen, number in zip(self._seen, numbers, strict=True):
            mine = number[number >= 0]
            free = torch.ones(len(seen.points), dtype=torch.bool)
            free[mine] = False
            if not free.any() or not len(mine):
                continue
            moved = seen.points[mine] - reference[number >= 0]
            nearest = torch.cdist(seen.points[free], seen.points[mine])
            place = seen.points[free] - moved[nearest.argmin(1)]
            # Leave out positions close to a known marker: these would be second detections of it.
            inferred.append(place[torch.cdist(place, reference).amin(1) > 2 * _SAME * spacing])
        places, kept = torch.cat(inferred) if inferred else reference[:0], []
        while len(places):
            near = torch.cdist(places[:1], places)[0] < _SAME * spacing
            if int(near.sum()) >= _SEEN_OFTEN:
                kept.append(places[near].median(0).values)
            places = places[~near]
        return torch.stack(kept) if kept else reference[:0]

    def _keep(self, reference: Tensor, ties: Ties, numbers: Tensor) -> None:
        shape = numbers.shape
        points = torch.full((*shape, 2), torch.nan, dtype=torch.float64)
        covariance = torch.full((*shape, 2, 2), torch.nan, dtype=torch.float64)
        status = torch.full(shape, TrackStatus.NO_TEXTURE, dtype=torch.uint8)
        for frame, (seen, number) in enumerate(zip(self._seen, numbers, strict=True)):
            mine = number >= 0
            points[frame, mine] = seen.points[number[mine]]
            covariance[frame, mine] = seen.covariance[number[mine]]
            unsure = seen.disagreement[number[mine]] > self._limit
            status[frame, mine] = torch.where(unsure, TrackStatus.MISMATCH, TrackStatus.TRACKED).to(torch.uint8)
            status[frame, mine & _are_overstretched(points[frame] - reference, ties)] = TrackStatus.OFF_NEIGHBOURS
            expected = torch.where(mine[:, None], points[frame], _expected_positions(reference, points[frame]))
            status[frame, self._are_cut(expected)] = TrackStatus.LEFT_FRAME
        lost = status != TrackStatus.TRACKED
        points[lost], covariance[lost] = torch.nan, torch.nan
        self.points, self.covariance, self.status = points.numpy(), covariance.numpy(), status.numpy()

    def _are_cut(self, points: Tensor) -> Tensor:
        """Return a mask (N,) of the markers at `points` (N, 2) px that the border of the view cuts off."""
        height, width = self._view.shape
        size = torch.tensor([width - 1.0, height - 1.0], dtype=points.dtype)
        return torch.minimum(points, size - points).amin(-1) < self.look.radius

    def _say_what_was_taken(self) -> None:
        inputs, first = self.inputs, self._number(0)
        if not self.at_rest[0]:
            self.warnings.append(
                f"the gel is not at rest in frame {first}: displacement counts from frame "
                f"{self._number(self.rest_frame)}, like which {int(self.at_rest.sum())} of {len(self.at_rest)} are"
            )
        least = _GAUGE_SPACINGS * self.spacing * inputs.mm_per_px
        if inputs.gauge_length_mm < least:
            self.warnings.append(
                f"the markers are {self.spacing * inputs.mm_per_px:.2g} mm apart: gradients are fitted over "
                f"{least:.2g} mm, not over fields.gauge_length_mm = {inputs.gauge_length_mm:g}"
            )
            inputs.gauge_length_mm = math.ceil(100 * least) / 100

    def _number(self, frame: int) -> int:
        return frame + self.inputs.scene.recording.first_frame


def _expected_positions(reference: Tensor, points: Tensor) -> Tensor:
    """Return expected marker positions (N, 2) px in a frame: rest position `reference` plus displacement of the nearest
    marker detected in the frame (`points`, NaN if not detected).
    """
    known = points.isfinite().all(-1)
    if not known.any():
        return reference
    moved = (points - reference)[known]
    return reference + moved[torch.cdist(reference, reference[known]).argmin(1)]


def _are_overstretched(moved: Tensor, ties: Ties) -> Tensor:
    """Return a mask (N,) of markers whose displacement `moved` (N, 2) px differs from those of most neighbours (pairs
    in `ties`) by more than a gel can stretch.
    """
    slope = (moved[ties.first] - moved[ties.second]).norm(dim=-1) / ties.distance
    dense = torch.full((len(moved), len(moved)), torch.nan, dtype=moved.dtype)
    dense[ties.first, ties.second] = slope
    return dense.nanmedian(1).values > _STEEPEST
