"""Skin ridges in the contact: ridge period, and offset of the ridges between the contact and topography views."""

from typing import NamedTuple

import cv2
import numpy as np

from fingerflow.kernels.array_types import Array, Mask, Picture

_SIDE_PX = 256  # longest side of the analysed patch of skin: a ridge then has some 10 px
_MEAN_PX = 25  # side of the local mean that is subtracted: longer waves are due to light and pressure
_SHORTEST_PX, _LONGEST_PX = 4.0, 40.0  # ridge periods that can be found in a patch
_BAND = 1.3  # ratio of frequencies: power within this ratio of the peak frequency belongs to the ridges
_LEAST_POWER = 0.45  # least share of the power within that band if ridges are distinct
_REACH_PX = 40  # largest offset between the views that is searched
# Least correlation of the ridges in two views that show the same skin; by chance it stays below 0.15.
_LEAST_CORRELATION = 0.3
_WEAKER = 0.75  # ratio of the correlation without an offset to the best one, below which the views are offset


class SkinPatch(NamedTuple):
    """Image `ridges` (h, w) of the skin in contact, corrected for uneven light and resampled to `scale` times the
    resolution of the contact view.

    `inside` (h, w) bool is the contact, `box` its rows and columns in the view.
    """

    ridges: Picture
    inside: Mask
    box: tuple[slice, slice]
    scale: float


def skin_patch(contact: Array, light: Picture, inside: Mask) -> SkinPatch | None:
    """Return the patch of skin within the mask `inside` (h, w) of a contact view; None if the patch is too small.

    Single pixels, hot or dead, are removed by a median.
    """
    rows, columns = (np.flatnonzero(inside.any(axis)) for axis in (1, 0))
    if len(rows) < _LONGEST_PX or len(columns) < _LONGEST_PX:
        return None
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    scale = min(1.0, _SIDE_PX / max(len(rows), len(columns)))
    share = (contact[box] / np.where(light[box] > 0, light[box], np.inf)).clip(0, 1.5).astype(np.float32)
    within = _reduced(inside[box].astype(np.float32), scale) > 0.5
    smooth = np.asarray(cv2.medianBlur(share, 3), np.float32)
    return SkinPatch(_flat(_reduced(smooth, scale), within), within, box, scale)


def period_px(skin: SkinPatch) -> float:
    """Return the spatial period of the skin ridges in px of the view, or NaN if no distinct ridges are found.

    It is the centre of the strongest band of the power spectrum, summed over rings of equal frequency.
    """
    rows, columns = skin.ridges.shape
    power = np.square(np.abs(np.fft.rfft2(skin.ridges)))
    frequency = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns))
    ring = np.rint(frequency * _SIDE_PX).astype(np.intp)
    rings, at = np.bincount(ring.ravel(), power.ravel()), np.arange(ring.max() + 1) / _SIDE_PX
    rings[(at < 1 / _LONGEST_PX) | (at > 1 / _SHORTEST_PX)] = 0
    peak = at[np.argmax(rings)]
    band = np.where((at > peak / _BAND) & (at < peak * _BAND), rings, 0)
    if not band.sum() > _LEAST_POWER * rings.sum():
        return float("nan")
    return float(band.sum() / (band @ at) / skin.scale)


def compare_views(skin: SkinPatch, topography: Array, topography_to_contact: Array) -> tuple[str, float]:
    """Return how the topography view must be turned over to show the ridges of the contact view, "left to right", "top
    to bottom" or "both ways", "" if it shows them as it is or neither does; and the distance, px of the contact view,
    between its ridges, mapped by the calibration, and those of the contact view, 0 if small or unknown.
    """
    correlation, reach = _correlation(skin, topography, topography_to_contact)
    peak = correlation.max()
    if not peak > _WEAKER:  # else no other picture, whose correlation is at most 1, is so much more alike
        pictures = {"left to right": topography[:, ::-1], "top to bottom": topography[::-1]}
        pictures["both ways"] = topography[::-1, ::-1]
        peaks = {name: _correlation(skin, turned, topography_to_contact)[0].max() for name, turned in pictures.items()}
        name = max(peaks, key=lambda turned: peaks[turned])
        if peaks[name] >= _LEAST_CORRELATION and peak < _WEAKER * peaks[name]:
            return name, 0.0
    if not peak >= _LEAST_CORRELATION or correlation[reach, reach] > _WEAKER * peak:
        return "", 0.0
    down, across = np.unravel_index(np.argmax(correlation), correlation.shape)
    return "", float(np.hypot(down - reach, across - reach)) / skin.scale


def _correlation(skin: SkinPatch, topography: Array, topography_to_contact: Array) -> tuple[Picture, int]:
    """Return the size of the correlation of the ridges in both views for shifts of up to `reach` px of the patch along
    y and x, and `reach`.

    A ridge is dark in the contact view and bright in the topography view, or dark in both: the sign does not count.
    """
    rows, columns = skin.box
    matrix = topography_to_contact - [[0, 0, columns.start], [0, 0, rows.start]]
    size = columns.stop - columns.start, rows.stop - rows.start
    picture = np.asarray(cv2.warpAffine(topography.astype(np.float32), matrix, size), np.float32)
    pattern = _flat(_reduced(picture, skin.scale), np.ones_like(skin.inside))
    pattern /= np.sqrt(np.maximum(_mean(pattern * pattern), np.float32(1e-12)))
    product = np.conj(np.fft.rfft2(skin.ridges)) * np.fft.rfft2(pattern)
    reach = min(_REACH_PX, *(side // 4 for side in pattern.shape))
    correlation = np.roll(np.fft.irfft2(product, pattern.shape), (reach, reach), (0, 1))
    norm = max(np.linalg.norm(skin.ridges) * np.linalg.norm(pattern[skin.inside]), 1e-30)
    return np.abs(correlation[: 2 * reach + 1, : 2 * reach + 1]) / norm, reach


def _reduced(picture: Picture, scale: float) -> Picture:
    """Return an image resampled by a factor `scale` of at most 1, by area averaging."""
    return np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.float32)


def _flat(picture: Picture, inside: Mask) -> Picture:
    """Return an image minus its local mean within the mask `inside`, so that nothing coarser than skin ridges remains;
    0 outside the mask.
    """
    weight = inside.astype(np.float32)
    mean = _mean(picture * weight)
    mean /= np.maximum(_mean(weight), np.float32(1e-3))
    return (picture - mean) * weight


def _mean(picture: Picture) -> Picture:
    """Return the mean of an image over a square of side `_MEAN_PX` around every pixel."""
    return np.asarray(cv2.blur(picture, (_MEAN_PX, _MEAN_PX)), np.float32)
