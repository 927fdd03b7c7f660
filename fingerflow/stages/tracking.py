"""Points of the skin through all frames of the topography view."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.errors import FingerflowError
from fingerflow.graphs import TrackGraph
from fingerflow.ops.cells import covered
from fingerflow.ops.corners import detect_corners
from fingerflow.ops.dense_region import cell_of
from fingerflow.ops.local_fit import local_gradients
from fingerflow.ops.noise import estimate_noise
from fingerflow.ops.tracking import Tracks, TrackStatus
from fingerflow.stages.inputs import Inputs

GIVES = frozenset(
    {
        "position",
        "position_px",
        "position_std_px",
        "forward_backward_error",
        "status",
        "tracked_share",
        "forward_backward_median",
    }
)
_CORNER_PX = 5  # a corner must be local; averaged over a tracking window few are left apart
_WARP_GAUGE_PX = 120.0  # over which the deformation of a template is taken to be uniform


@dataclass
class TrackSeries:
    """Tracks of all frames, px of the topography view; NaN where the status is not TRACKED."""

    position: NDArray[np.float64]
    deviation: NDArray[np.float32]
    error: NDArray[np.float32]
    status: NDArray[np.uint8]


class TrackingStage:
    """Follows points from frame to frame, in the order of time or against it.

    With keyframes every frame is compared with the first one, the template deformed by the gradient of the motion found
    so far: errors do not add up. From frame to frame they do.
    """

    def __init__(self, inputs: Inputs, region: Tensor) -> None:
        """``region`` (1, 1, h, w) bool: where to look for points, px of the contact view."""
        view = inputs.scene.views.topography
        if view is None:
            raise FingerflowError(
                f"{inputs.scene.path}: tracking needs the topographic view; add [views.topography] with rows "
                f"and columns"
            )
        self._inputs = inputs
        self._view = view
        self._settings = inputs.scene.tracking
        self._graph = TrackGraph(
            self._settings.window_px,
            self._settings.forward_backward_limit_px,
            self._settings.search_px,
            self._settings.gain_offset,
        )
        self._matrix = torch.from_numpy(inputs.topography_to_contact).to(inputs.device, torch.float32)
        self._identity = torch.eye(2, device=inputs.device)
        self._region = region
        self._template: Tensor | None = None
        self._start = torch.empty(0)
        self._last = torch.empty(0)
        self._noise = torch.empty(0)  # of the template, (1,) grey levels
        self._warp: Tensor | None = None
        self.series: TrackSeries | None = None

    def run(self, indices: NDArray[np.intp], frames: NDArray[np.generic], excess: Tensor) -> NDArray[np.bool_]:
        """Tracks through these frames, in the order given; says which points the gross contact (`Contact.excess`)
        covers, (n, N)."""
        images = self._inputs.view(frames, self._view)
        steps, where = [], []
        for image, noise in zip(images.split(1), estimate_noise(images).split(1), strict=True):
            steps.append(self._step(image, noise))
            where.append(self._last)
        assert self.series is not None
        tracks = Tracks(*(torch.cat(values) for values in zip(*steps, strict=True)))
        self.series.position[indices] = tracks.points.cpu()
        variances = tracks.covariance.diagonal(dim1=-2, dim2=-1)
        self.series.deviation[indices] = variances.mean(-1).sqrt().cpu()
        self.series.error[indices] = tracks.error.cpu()
        self.series.status[indices] = tracks.status.cpu()
        return self._inside(excess, torch.cat(where)).cpu().numpy()

    def _step(self, image: Tensor, noise: Tensor) -> Tracks:
        """Finds the points in the next image (1, 1, h, w), whose noise is (1,)."""
        if self._template is None:
            self._begin(image)
            self._noise = noise
            exact = torch.zeros_like(self._start[..., 0])
            return Tracks(self._start, exact, exact[..., None, None].expand(-1, -1, 2, 2), exact.to(torch.uint8))
        both = torch.maximum(self._noise, noise)
        tracks: Tracks = self._graph(self._template, image, self._start, self._last, self._warp, both)
        if self._settings.template == "keyframe":
            tracks = tracks._replace(points=self._deform(tracks.points))
            # A point that is lost in one frame may be found again in the next, near where it was last.
            self._last = torch.where(tracks.points.isfinite(), tracks.points, self._last)
        else:
            self._template, self._noise, self._start, self._last = image.clone(), noise, tracks.points, tracks.points
        return tracks

    def _begin(self, image: Tensor) -> None:
        """Chooses the points in the first frame."""
        settings = self._settings
        region = cv2.warpAffine(
            self._region[0, 0].cpu().numpy().astype(np.uint8),
            self._inputs.topography_to_contact,
            (image.shape[3], image.shape[2]),
            flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
        )
        mask = torch.from_numpy(region).to(image.device)[None, None] > 0
        border = settings.window_px // 2 + 2
        corners = detect_corners(
            image, settings.points, settings.min_distance_px, mask, window=_CORNER_PX, border=border
        )
        points = corners.points[:, corners.valid[0]]
        if points.shape[1] < 3:
            raise FingerflowError(
                f"{self._inputs.recording.path}: {points.shape[1]} points with texture were found in the "
                f"contact region of the "
                "topographic view, at least 3 are needed. Check [views.topography], the calibration and the focus."
            )
        # A copy: the image is a part of a batch of frames, which it would keep in memory.
        self._template, self._start, self._last = image.clone(), points, points
        count = (len(self._inputs.recording), points.shape[1])
        self.series = TrackSeries(
            position=np.full((*count, 2), np.nan),
            deviation=np.full(count, np.nan, dtype=np.float32),
            error=np.full(count, np.nan, dtype=np.float32),
            status=np.full(count, TrackStatus.NOT_FINITE, dtype=np.uint8),
        )

    def _deform(self, found: Tensor) -> Tensor:
        """Learns the deformation of the templates from where they were found, and corrects the positions for it.

        The templates of the next frame are deformed by the gradient F. What varies within a window beyond F displaces
        it as a whole: u(p + w) = u + F w + w'Hw / 2, and the mean of w'Hw / 2 over a square of n px, the Laplacian of u
        times (n^2 - 1) / 24, is taken off. At n = 25 it is 0.02 px where the divergence of skin changes by 2 % a mm.
        """
        moved = found - self._start
        gradient = local_gradients(self._start, moved, gauge_length=_WARP_GAUGE_PX).gradient
        self._warp = gradient.nan_to_num(0.0, 0.0, 0.0) + self._identity
        second = local_gradients(self._start, gradient.flatten(-2), gauge_length=_WARP_GAUGE_PX).gradient
        laplacian = second.unflatten(2, (2, 2)).diagonal(dim1=-1, dim2=-2).sum(-1)
        return found - laplacian.nan_to_num(0.0, 0.0, 0.0) * ((self._graph.window**2 - 1) / 24)

    def _inside(self, excess: Tensor, points: Tensor) -> Tensor:
        """Whether the gross contact (`Contact.excess`) covers points (n, P, 2) of the topographic view, (n, P)."""
        x, y = (points @ self._matrix[:, :2].T + self._matrix[:, 2]).unbind(-1)
        return covered(excess, x, y, cell_of(self._inputs.scene.contact.gross_radius_px))
