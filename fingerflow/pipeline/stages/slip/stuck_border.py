"""Border of the stick region: the line in the contact at which displacement of the skin begins."""

import math

import cv2
import numpy as np
import torch
from scipy.ndimage import binary_fill_holes

from fingerflow.kernels.array_types import Field, Mask, Series
from fingerflow.models.partial_slip.stick_border import BorderFit, RampResponse, border_level, fit_border
from fingerflow.ops.fields.rigid_motion import rigid_residual
from fingerflow.pipeline.stages.slip.slip_grid import SlipGrid

# mm, largest level at the border; a higher one is not distinguishable from the displacement beside the border.
_LARGEST_MM = 0.08
FOLLOWED_MM = 0.02  # mm, displacement of the contour along which displacements are averaged: far above their noise
_FEWEST_SLIPPED = 5  # least number of slipping points of a frame for the direction of slip
_HELD_SHARE = 0.25  # share of the slip limit below which points are taken to stick
_FEWEST_HELD = 3  # least number of points for the fit of a rigid motion
_LEAST_INSIDE = 0.1  # least share of the contact inside the contour, so that some windows do not reach the contour
_BINS_A_WINDOW = 14
_FROM, _TO = -2.0, 3.5  # range of the fit in half windows from the contour, negative outside it
# Half windows, least distance of points and contour from the rim, where windows show less displacement than the law.
_APART = 0.5
_SMOOTHED = 0.3  # half windows, standard deviation of the smoothing of the contour
# Half windows, error of the border on rendered trials of several laws that the fit's deviation does not contain.
_PLACE_STD = 0.15
_SHARED = 0.25  # error of the displacement that the points along a border share, as a share of the noise of a point
_DEEP = 1.75  # half windows, least depth inside the contour at which no window reaches slipping skin
_LEAST_POINTS = 20  # least number of points in a bin
_MOST_POINTS = 400  # largest count in the weight of a bin, since points are not independent
_LEAST_SPREAD_MM = 1e-4
# Shares of `level` that are tried: the level grows with the width of a narrow annulus.
_STEPS = np.linspace(0.15, 1, 18)
_WIDEST = 3.0  # half windows, width of the annulus above which the level is constant


class StuckBorder:
    """Stick region of each frame, bounded by a contour of displacement whose level is fitted to all frames of a trial.

    In every frame the contour of 0.02 mm is far above the noise. The displacement of the points along the direction
    of slip is averaged over all frames by their distance from the contour, which leaves a noise of a tenth of a
    micrometre. The fit finds where this displacement begins, as it is measured, and by which law
    (`models.partial_slip.stick_border`). It gives the level measured at the border; the stick region of a frame is
    where displacement is below it.

    Args:
        grid: of the contact.
        half_window_mm: half of the window over which a displacement is measured.
        seen: measured displacement for one that begins at a border.
        clear: multiple of the noise. Where the level is lower than that, the contour at this multiple is used, and the
            border lies inside of it by the distance that the fit gives.

    Attributes:
        fit: None where the fit failed; `reason` says why, and the level is 0.02 mm.
        level: mm, for a slipping annulus wider than a window.
        noise: mm, standard deviation of the displacement of points that stick.
    """

    def __init__(self, grid: SlipGrid, half_window_mm: float, seen: RampResponse, clear: float) -> None:
        self._grid, self._half, self._seen, self._above = grid, half_window_mm, seen, clear
        bins = round((_TO - _FROM) / 2 * _BINS_A_WINDOW)
        self._edges = np.linspace(_FROM, _TO, bins + 1) * half_window_mm
        self._sums = np.zeros((3, bins))  # over the points in each bin: number, displacement and its square
        self._deep_count, self._deep_squares, self._deep_sum = 0, 0.0, np.zeros(2)
        self._direction = np.zeros(2)
        self.fit: BorderFit | None = None
        self.level, self.noise, self.reason = FOLLOWED_MM, np.nan, ""
        self._base = np.zeros(2)
        self._widths = np.linspace(0, _WIDEST, 200) * half_window_mm  # mm, widths of the annulus
        self._of_width = np.zeros(200)  # mm, level for each width

    def gather(self, moved: Series, displacement: Field, region: Mask) -> None:
        """Add the displacements in one frame to the fit of the stick region's border.

        Args:
            moved: (N, 2) mm, displacement of the points, NaN where lost.
            displacement: (rows, columns, 2) mm, of the cells.
            region: (rows, columns) cells in contact.
        """
        length = np.linalg.norm(moved, axis=-1)
        slipped = length > FOLLOWED_MM
        if slipped.sum() < _FEWEST_SLIPPED:
            return
        contact = self._grid.fine_mask(region & self._grid.known)
        along = moved[slipped].sum(0)
        direction = along / np.linalg.norm(along)
        still = self._smoothed(displacement @ direction.astype(np.float32)) < FOLLOWED_MM
        inside, outside = contact & still, contact & ~still
        if inside.sum() < _LEAST_INSIDE * contact.sum() or not outside.any():
            return
        self._direction += along
        depth = self._grid.sample_points(np.where(inside, _distance(outside), -_distance(inside))) * self._grid.fine_mm
        to_rim = self._grid.sample_points(_distance(~contact)) * self._grid.fine_mm
        used = np.isfinite(length) & (to_rim - np.maximum(depth, 0) > _APART * self._half)
        component = moved @ direction
        for total, weights in zip(self._sums, (None, component[used], component[used] ** 2), strict=True):
            total += np.histogram(depth[used], self._edges, weights=weights)[0]
        deep = used & (depth > _DEEP * self._half)
        self._deep_count += int(deep.sum())
        self._deep_sum += moved[deep].sum(0)
        self._deep_squares += float((component[deep] ** 2).sum())

    def _smoothed(self, component: Field) -> Field:
        """Return a displacement component, given on the contact cells, interpolated to the fine grid and smoothed: a
        contour made uneven by noise would lie nearer to the points around it.
        """
        weight = self._grid.fine_mask(self._grid.known).astype(np.float32)
        width = _SMOOTHED * self._half / self._grid.fine_mm
        images = self._grid.fine(component) * weight, weight
        total, share = (cv2.GaussianBlur(image, (0, 0), width) for image in images)
        return np.asarray(total / np.maximum(share, 1e-6))

    @property
    def position_std(self) -> float:
        """Return the standard deviation, mm, of the stick border's position, one value for all frames; NaN if no border
        was found.

        It is that of the fit, that of the model, and the distance over which slip grows to the error that the points
        of a border share.
        """
        if self.fit is None:
            return math.nan
        return math.hypot(self.fit.offset_std, _PLACE_STD * self._half, self.fit.slip_distance(_SHARED * self.noise))

    @property
    def followed(self) -> float:
        """Return the displacement, mm, whose contour line bounds the stick region where the slipping annulus around it
        is wide: the fitted level, or the least level clear of noise if that is larger.
        """
        return float(np.fmax(self.level, self._above * self.noise))

    def settle(self) -> None:
        """Fit the border of the stick region to the displacements of all frames added by `gather`."""
        if self._deep_count:
            self._base = self._deep_sum / self._deep_count
            self.noise = float(np.sqrt(self._deep_squares / self._deep_count))
        filled = self._sums[0] >= _LEAST_POINTS
        count, total, squares = self._sums[:, filled]
        mean = total / count
        spread = np.sqrt(np.maximum(squares / count - mean**2, _LEAST_SPREAD_MM**2))
        middle = ((self._edges[1:] + self._edges[:-1]) / 2)[filled]
        self.fit = fit_border(middle, mean, np.minimum(count, _MOST_POINTS) / spread**2, self._seen, self._half)
        if self.fit is None:
            self.reason = "no frames show a stuck part with slipping skin around it"
            return
        self._of_width = border_level(self._widths, self.fit, self._seen)
        level = float(self._of_width[-1])
        if level >= _LARGEST_MM:
            self.reason = (
                f"beside the stuck part displacement grows so steeply, by {self.fit.growth:.2g} mm over the first mm, "
                f"that what is seen over {2 * self._half:.2f} mm shows {1000 * level:.0f} µm at its border"
            )
            self.fit = None
            return
        self.level = level

    def stuck(self, moved: Series, displacement: Field, region: Mask) -> Mask:
        """Return the stick region of one frame as a mask on the fine grid, given the displacements of points and cells
        and the contact region (arguments as for `gather`).
        """
        contact = self._grid.fine_mask(region)
        inside = contact & self._grid.fine_mask(self._grid.known)
        length = self._grid.fine(np.linalg.norm(displacement, axis=-1))
        if self.fit is None:
            return inside & (length < FOLLOWED_MM)
        slipped = displacement[region & self._grid.known & (np.linalg.norm(displacement, axis=-1) > FOLLOWED_MM)]
        along = slipped.sum(0) if len(slipped) else self._direction
        direction = (along / np.linalg.norm(along)).astype(np.float32)
        component = self._grid.fine((displacement - self._base.astype(np.float32)) @ direction)
        levels = _STEPS * self.level
        share = np.searchsorted(np.sort(component[inside]), levels) / max(int(contact.sum()), 1)
        radius = np.sqrt(contact.sum() / np.pi) * self._grid.fine_mm
        at_border = np.interp(radius * (1 - np.sqrt(np.minimum(share, 1))), self._widths, self._of_width)
        first = int(np.argmax(levels >= at_border)) if (levels >= at_border).any() else len(levels) - 1
        clear, beyond = self._clear(float(levels[first]), radius * (1 - math.sqrt(min(float(share[first]), 1))))
        held = inside & (length < max(FOLLOWED_MM, self.followed))
        slow = held & (component < clear)
        # A low level applies to a narrow annulus at the rim. A hole that does not reach the rim is no annulus: below
        # the level of a wide annulus it is noise.
        slow |= binary_fill_holes(slow) & held & (component < self.followed)
        return slow & (_distance(contact & ~slow) * self._grid.fine_mm > beyond) if beyond > 0 else slow

    def _clear(self, level: float, width: float) -> tuple[float, float]:
        """Return the displacement, mm, of the contour to draw in a slipping annulus `width` mm wide, and how far, mm,
        this contour lies outside the stick border, where the displacement is `level`.

        This is the level at the border itself, or a higher one where noise requires it, as far as it is reached in a
        slipping annulus of this width.
        """
        assert self.fit is not None
        at, seen = np.linspace(0, width / 2, 100), self.fit.blurred_displacement
        shown = np.maximum.accumulate(seen(at, self._seen) - seen(at - width, self._seen))
        clear = min(self._above * self.noise, float(shown[-1]))
        if not clear > level:
            return level, 0.0
        return clear, float(np.interp(clear, shown, at) - np.interp(level, shown, at))


class Length:
    """Criterion of sticking by a length: skin sticks while displaced by less than a given length.

    Args:
        grid: of the contact.
        limit_mm: the length.
        relative: relative to the best rigid motion of the points that stuck in the frame before, at first of all points
            in contact. Skin that has come loose does not stick again, and where fewer than three points stick nothing
            does.
    """

    def __init__(self, grid: SlipGrid, limit_mm: float, relative: bool) -> None:
        self._grid, self._limit, self._relative = grid, limit_mm, relative
        self._held: Mask | None = None  # (N,) points that stuck in all frames so far

    def stuck(self, moved: Series, displacement: Field, region: Mask) -> Mask:
        """Return the stick region of one frame as a mask on the fine grid, given the displacements of points and cells
        and the contact region (arguments as for `StuckBorder.gather`).
        """
        contact = self._grid.fine_mask(region & self._grid.known)
        if not self._relative:
            return contact & (self._grid.fine(np.linalg.norm(displacement, axis=-1)) < self._limit)
        held = self._grid.sample_points(contact) > 0 if self._held is None else self._held
        if np.sum(held & np.isfinite(moved).all(-1)) < _FEWEST_HELD:
            self._held = np.zeros_like(held)
            return np.zeros_like(contact)
        weights = torch.from_numpy(held.astype(np.float64))[None]
        left = rigid_residual(torch.from_numpy(self._grid.points)[None], torch.from_numpy(moved)[None], weights)
        length = self._grid.fine(np.linalg.norm(self._grid.displacement(left[0].numpy()), axis=-1))
        # Leave out skin near the limit: some of it has slipped already and would bias the fitted motion of the glass.
        self._held = held & (self._grid.sample_points(length) < _HELD_SHARE * self._limit)
        return contact & (length < self._limit)


def _distance(mask: Mask) -> Field:
    """Return the distance to the edge of a mask at each position outside the mask, in spacings of the fine grid."""
    distance = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    return np.asarray(distance - 0.5, dtype=np.float32)
