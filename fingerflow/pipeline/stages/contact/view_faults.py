"""Checks of what lies in the contact view beside the finger: unlit glass, dark objects, sweat, shadows, moved camera.

Each check yields warnings that name the cause. Pictures are (h, w) of the contact view; `light` is the empty glass
without the dark level, 0 where it is not lit; `share` is the share of that light in a frame, NaN where it is not lit.
"""

from collections.abc import Iterable, Iterator

import cv2
import numpy as np

from fingerflow.kernels.array_types import Array, Mask, Numbers, Picture

_UNLIT_BORDER = 0.03  # largest share of the contact's border that may lie on unlit glass
_STRIP, _STRIP_MM = 4.0, 3.0  # ratio of the axes, and length in mm, above which a contact region is no fingertip
_SOLID = 0.2  # largest share of the real contact in patches wider than a ridge; ridges that merge make up to 0.17
_ALL_SOLID = 0.8  # share above which the contact is not one of ridges at all, and no warning is given
# Least area of a second contact as a share of the largest gross contact area, and least share of it that touches.
SECOND_CONTACT, DENSITY = 0.015, 0.2
_SHADOW = 0.04  # least share of its light that the glass around the contact loses to a shadow
# Ridges cover 0.78 +- 0.05 of what they cover further inside within one period of the border of clean prints, with a
# larger scatter on small contacts, and less where they are thin there: the border then lay 0.1 to 0.4 mm further out.
_THIN, _SCATTER, _RAMP, _THIN_MM = 0.69, 0.3, 0.06, 0.27
_STEP = 1.35  # least ratio of the light of successive lines of the background at which it is torn
_REACH_PX, _MOVED_PX = 12, 1.5  # px, largest shift of the glass that is searched, and least shift that is reported
# Least relative slope of the light at edges of the glass, 1/px, and least number of compared pixels for a shift.
_EDGE, _EDGE_PX = 0.02, 50
_BETTER = 0.5  # ratio of the residuals with and without the shift, below which the glass has moved
_UNEVEN = 0.05  # least relative change of light that is reported


def check_unlit_glass(region: Mask, light: Picture, radius_px: int) -> Iterator[str]:
    """Yield a warning if the contact region reaches glass without light, where its border is not that of the skin; the
    `light` is 0 outside of views.contact.region too.
    """
    around = cv2.dilate(region.astype(np.uint8), _disc(radius_px)).astype(bool) & ~region
    unlit = (light[around] <= 0).mean() if around.any() else 0.0
    if unlit > _UNLIT_BORDER:
        yield (
            f"the contact reaches glass without light or the border of views.contact.region along {unlit:.0%} of its "
            f"border: results are of the part inside. Light the whole contact, and draw the region around it"
        )


def check_strip(semi_axes: Picture, gross: Picture, first_frame: int) -> Iterator[str]:
    """Yield a warning if the region detected as contact is far longer than wide in some frame, as it is where a cable
    lies in the view.

    `semi_axes` (frames, 2) mm of the fitted ellipse, major first, and gross area `gross` (frames,) mm^2 are NaN in
    unusable frames.
    """
    major, minor = semi_axes.T
    frames = np.flatnonzero((gross > 0) & (2 * major > _STRIP_MM) & (major > _STRIP * minor))
    if len(frames):
        frame = frames[0]
        yield (
            f"a dark strip lies in the view, {2 * major[frame]:.2g} mm long and {np.pi / 2 * minor[frame]:.2g} mm wide "
            f"in frame {frame + first_frame}, and counts as contact, such as a cable. Remove it, leave it out by "
            f"views.contact.region, or record the empty glass again"
        )


def outside_region(region: Mask, cell_px: int, radius_px: int) -> Mask:
    """Return the cells, of `cell_px` px, that are further than `radius_px` from those of the gross contact `region`."""
    return cv2.dilate(region.astype(np.uint8), _disc(-(-radius_px // cell_px))) == 0


def check_second_contact(outside: Mask, least_px: float, radius_px: int, pixel_mm2: float, frame: int) -> Iterator[str]:
    """Yield a warning if a contact of `least_px` px lies outside the gross contact region, as of a second finger or a
    knuckle.

    `outside` is the real contact mask outside that region. Ridges are merged over `radius_px`; the largest part counts.
    """
    touching = outside.astype(np.uint8)
    merged: Array = touching
    for operation in (cv2.MORPH_CLOSE, cv2.MORPH_OPEN):
        merged = cv2.morphologyEx(merged, operation, _disc(radius_px))
    _, labels, parts, _ = cv2.connectedComponentsWithStats(merged, connectivity=8)
    areas = parts[1:, cv2.CC_STAT_AREA]
    area = areas.max(initial=0)
    if area > least_px and (real := touching[labels == 1 + areas.argmax()].sum()) >= DENSITY * area:
        yield (
            f"a second contact lies in the view, as of another finger or a knuckle: {real * pixel_mm2:.2g} mm² of "
            f"real contact in {area * pixel_mm2:.2g} mm² in frame {frame}. Results are of the densest part alone, or "
            f"of both where they merge. Leave the other out by views.contact.region, or press with one finger"
        )


def check_sweat(touching: Mask, period_px: float) -> Iterator[str]:
    """Yield a warning if much of the real contact lies in patches wider than a ridge, as where sweat fills the valleys
    between the ridges: the share covered by discs 1.1 ridge periods in diameter which lie within the mask (a
    morphological opening).

    `touching` is the real contact mask; `period_px` is the ridge period.
    """
    solid = cv2.morphologyEx(touching.astype(np.uint8), cv2.MORPH_OPEN, _disc(round(0.55 * period_px)))
    share = solid.sum() / max(touching.sum(), 1)
    if _SOLID < share < _ALL_SOLID:
        yield (
            f"{share:.0%} of the real contact lies in patches wider than a ridge: sweat or grease fills the valleys "
            f"there and counts as contact. Dry finger and glass"
        )


def check_shadow(share: Picture, away: Picture, period_px: float) -> Iterator[str]:
    """Yield a warning if the glass just outside the contact region is darker in a frame than when empty, as in a
    shadow of the finger.

    `share` (h, w) is the intensity relative to that of the empty glass, corrected for the illumination gain; `away`
    (h, w) px is the distance from that region.
    """
    around = share[(away > 0.4 * period_px) & (away < 1.2 * period_px) & np.isfinite(share)]
    left = np.median(around) if len(around) else 1.0
    if left < 1 - _SHADOW:
        yield (
            f"the glass around the contact has lost {1 - left:.0%} of its light: a shadow of the finger lies there and "
            f"counts as contact where it is dark. Light the glass evenly, or refocus"
        )


def thin_rim_mm(touching: Mask, region: Mask, period_px: float) -> float:
    """Return by how much, mm, the border may lie further out as ridges are thin at the rim of the contact: nothing
    shows the skin beyond the last of them. `touching` is the real contact mask, `region` that of the gross contact.
    """
    depth = cv2.distanceTransform(region.astype(np.uint8), cv2.DIST_L2, 5) / period_px
    rim, inner = touching[(depth > 0) & (depth <= 1)], touching[depth > 2]
    usual = _THIN - _SCATTER * period_px / np.sqrt(max(len(inner), 1))
    return _THIN_MM * np.clip((usual - rim.mean() / inner.mean()) / _RAMP, 0, 1) if inner.any() else 0.0


def check_background_lines(light: Picture) -> Iterator[str]:
    """Yield a warning if rows of the background image `light` differ in brightness from the rows beside them, as in a
    torn picture.
    """
    full = _full_light(light)
    if not full > 0:
        return
    bright = np.maximum(light[:, ::4], 0.02 * full)
    lighter = np.maximum(bright[1:], bright[:-1])
    lit, step = lighter > 0.3 * full, lighter > _STEP * np.minimum(bright[1:], bright[:-1])
    count = np.count_nonzero(lit, 1)
    # The median step is above _STEP if more than half of the steps are.
    torn = (count > 0.25 * bright.shape[1]) & (2 * np.count_nonzero(lit & step, 1) > count)
    if torn.any():
        row = np.argmax(torn) + 1
        yield (
            f"lines of the background differ in light from the lines beside them, from row {row} of the contact view "
            f"on: a picture is torn, and no contact is seen there. Record the empty glass again"
        )


def check_moved_glass(frames: Iterable[tuple[int, Picture]], light: Picture, away: Picture) -> Iterator[str]:
    """Yield a warning if the edges of the lit area lie elsewhere in a frame than in the background `light`, as after a
    bump that moved camera or glass.

    `frames` are numbered and without the dark level; the first with such a shift is reported. Edges within the contact
    region do not count; `away` (h, w) px is the distance from it.
    """
    smooth = _smooth(light)
    y, x = _edges_of_glass(smooth, away)
    if len(y) < _EDGE_PX:
        return
    for number, frame in frames:
        shift, better = _shift_of_glass(_smooth(frame)[y, x], smooth, y, x)
        if np.hypot(*shift) >= _MOVED_PX and better < _BETTER:
            yield (
                f"the light on the glass has moved by {np.hypot(*shift):.0f} px between the background and frame "
                f"{number}: camera or glass was bumped, and edges of the light count as contact. Record the empty "
                f"glass again, or leave these frames out"
            )
            return


def check_empty_view(frame: Picture, light: Picture, number: int) -> Iterator[str]:
    """Yield a sentence for each fault that hides the finger in a frame without contact: a torn background, glass that
    moved, uneven light.
    """
    yield from check_background_lines(light)
    yield from check_moved_glass([(number, frame)], light, np.full(light.shape, np.inf))
    share = np.divide(frame, light, out=np.ones(light.shape), where=light > 0)
    # The middles of two halves of a view are half of its side apart.
    halves = [[float(np.median(half)) for half in np.array_split(share, 2, axis)] for axis in (0, 1)]
    across = 2 * float(np.linalg.norm(np.diff(halves)))
    fall = across / (float(np.median(share)) + across / 2)
    if fall > _UNEVEN:
        yield (
            f"the light falls by {fall:.0%} across the view against the background: the lamp was moved or warms up, so "
            f"record the empty glass again"
        )


def _edges_of_glass(smooth: Picture, away: Picture) -> tuple[Numbers, Numbers]:
    """Return the rows y and columns x of up to 1000 pixels near edges of brightness in the smoothed background, outside
    the contact region, among every second row and column.
    """
    coarse = np.ascontiguousarray(smooth[::2, ::2])
    across, down = (cv2.Sobel(coarse, cv2.CV_32F, *axis) for axis in ((1, 0), (0, 1)))
    steep = across * across + down * down > (16 * _EDGE * _full_light(smooth)) ** 2
    inner = (slice(_REACH_PX // 2, -_REACH_PX // 2),) * 2
    near = cv2.dilate(steep.view(np.uint8), _disc(2)).view(bool) & (away[::2, ::2] > 2 * _REACH_PX)
    y, x = np.nonzero(near[inner])
    step = max(1, len(y) // 500)
    return 2 * y[::step] + _REACH_PX, 2 * x[::step] + _REACH_PX


def _shift_of_glass(seen: Picture, light: Picture, y: Numbers, x: Numbers) -> tuple[tuple[int, int], float]:
    """Return the shift (x, y), px, of brightness edges in a frame relative to the background `light`, and the residual
    of the match with this shift divided by that without a shift.

    `seen` are the frame's pixels at y and x.
    """
    side = 2 * _REACH_PX + 1
    lines = np.lib.stride_tricks.sliding_window_view(light.ravel(), side)
    residual, even = np.empty((side, side)), np.full(len(seen), 1 / len(seen), seen.dtype)
    for k in range(side):
        # Collect the background pixels of a line around each edge pixel; the last one is that of the largest shift to
        # the left.
        shifted = lines[(y + _REACH_PX - k) * light.shape[1] + x - _REACH_PX]
        gain = seen @ shifted / np.maximum(np.einsum("nk,nk->k", shifted, shifted), 1e-9)
        residual[k] = (even @ np.abs(seen[:, None] - gain * shifted))[::-1]
    down, right = np.unravel_index(residual.argmin(), residual.shape)
    least = residual[down, right] / max(residual[_REACH_PX, _REACH_PX], 1e-9)
    return (int(right) - _REACH_PX, int(down) - _REACH_PX), float(least)


def _full_light(light: Picture) -> float:
    return float(np.quantile(light[::4, ::4], 0.99))


def _smooth(picture: Picture) -> Picture:
    return np.asarray(cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 1.0))


def _disc(radius: int) -> Array:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2), np.uint8)
