"""Whether points are still on the skin they were chosen on: their windows then and now, beside what found them."""

import torch
from torch import Tensor

from fingerflow.graphs.track import WARP_GAUGE_PX
from fingerflow.ops.noise import estimate_noise
from fingerflow.ops.point_gradients import point_gradients
from fingerflow.ops.tracking_limits import TrackStatus
from fingerflow.ops.window_correlation import correlation, deformed_alike, sample_windows

_STEP = 3  # px of a window's grid: 81 samples of a window of 25 px
_ALIKE = 0.05  # of 1 - correlation that nothing but a shift makes: ridges that repeat every 15 px, by 1.5 px
_USUAL, _MOST = 4.0, 0.2  # times the median of all points that one may have, where that is more, and its bound
_NOISE = 3.0  # times what the noise of two pictures takes from a correlation


class SecondLook:
    """Compares the window of each point in the picture in which it was chosen with that where it is now.

    The window is deformed by the gradient of the motion of all points around (`point_gradients`), sampled in the
    recorded picture and correlated, whatever gain and offset of the light. A point fails where 1 - correlation exceeds
    5 %, or four times the median of all points where that is more (light, focus and contact change all of them), plus
    three times sigma^2 / S, what noise of variance sigma^2 takes from windows of variance S; and where no other
    deformation with the same middle explains it (`deformed_alike`). On synthetic presses, slides and fingerprints, with
    disturbances, none of 220,000 positions that are right fails; of those beside their skin by 1 to 2 px 57 to 64 % do,
    by 2 to 4 px 89 % or more, beyond that 98 % or more (`python -m bench second_look`). Slow departures by 1.0 to
    1.3 px, as a slide has, are not found: the window changes as little. A window without neighbours, by whose motion it
    would be deformed, is not looked at. Where most points are being lost gradients are poor: of a slide in 16 frames 16
    of 21 wrong positions are found, and 106 of 1637 right ones are lost.
    """

    def __init__(self, image: Tensor, points: Tensor, window: int, around: Tensor | None = None) -> None:
        """`image` (1, 1, h, w) in which the points (N, 2) px were chosen, and other points (A, 2) px were `around`."""
        self._window, self._points = window, len(points)
        self._start = points if around is None else torch.cat((points, around))
        straight = torch.eye(2, dtype=points.dtype, device=points.device).expand(len(points), 2, 2)
        number = torch.zeros(len(points), dtype=torch.int64, device=points.device)
        self._first = sample_windows(image, number, points, straight, window, _STEP)
        self._variance = self._first.var(1)
        self._failed = torch.zeros(len(points), dtype=torch.bool, device=points.device)

    def failed(self, images: Tensor, points: Tensor, status: Tensor, around: Tensor | None = None) -> Tensor:
        """(N,) points that are not to be trusted in these images (n, 1, h, w), where they are at (n, N, 2) px, and
        those `around` at (A, 2) px in the last one.

        Looked at once, in the last image in which it is tracked: a point that fails there, or failed in the images
        before, may have been beside its skin in any of these. A look at 700 points costs 2 ms on one thread, for eight
        frames.
        """
        tracked = status == TrackStatus.TRACKED
        order = torch.arange(1, len(images) + 1, device=status.device)[:, None]
        last = (tracked * order).amax(0)  # 0 for none
        number = (last - 1).clamp_min(0)
        places = points[number, torch.arange(len(number), device=status.device)]
        places = torch.where((last > 0)[:, None], places, torch.nan)
        every = places if around is None else torch.cat((places, around))
        gradient, _ = point_gradients(self._start[None], (every - self._start)[None], WARP_GAUGE_PX)
        warp = torch.eye(2, dtype=places.dtype, device=places.device) + gradient[0, : self._points]
        apart = self._apart(images, number, places, warp)
        noise = estimate_noise(images[-1:]) ** 2 / self._variance
        usual = (_USUAL * apart.nanmedian()).nan_to_num(0.0).clamp(_ALIKE, _MOST)
        limit = usual + _NOISE * noise
        suspect = (apart > limit).nonzero().squeeze(1)
        if len(suspect):
            # Skin deforms unevenly beside its border: so would a window that is where it was.
            some = (number[suspect], places[suspect])
            better = deformed_alike(self._first[suspect], images, *some, warp[suspect], self._window, _STEP)
            again = self._apart(images, *some, better, suspect)
            apart[suspect] = torch.where(again.isnan(), apart[suspect], torch.minimum(again, apart[suspect]))
        before = self._failed
        # One that cannot be looked at is as it was.
        self._failed = torch.where(apart.isnan(), before, apart > limit)
        return before | self._failed

    def forget(self) -> None:
        """As if no point had failed before."""
        self._failed = torch.zeros_like(self._failed)

    def _apart(
        self, images: Tensor, number: Tensor, places: Tensor, warp: Tensor, chosen: Tensor | None = None
    ) -> Tensor:
        """1 - correlation of windows now with those of the chosen points, all by default."""
        now = sample_windows(images, number, places, warp, self._window, _STEP)
        return 1 - correlation(self._first if chosen is None else self._first[chosen], now)
