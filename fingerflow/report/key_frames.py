"""Key frames of a trial for maps and tables: selected by force, load ratio, displacement or contact area."""

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fingerflow.plot.abscissa import varies
from fingerflow.results.largest_load import frame_of_largest

LEVELS_N = (1.0, 2.0, 3.0)
_MOST = 5
_APART = 0.02  # least distance between two key frames, as a share of all frames
_LOADED = 0.2  # share of the largest normal force above which the load ratio of a frame counts


KeyFrame = tuple[int, str]  # frame that a report shows in detail: index in the result, and reason for the selection


def key_frames(result: xr.Dataset) -> list[KeyFrame]:
    """Select up to five key frames of a result, in order of time: at the largest force, for example.

    Of more candidates those named first below are selected. If the normal force varies: its largest value, then 3, 2
    and 1 N (or 0.75, 0.5 and 0.25 of the largest). If only the load ratio varies: its largest value, the last frame,
    half of the largest, and a frame while sliding. Otherwise, or if fewer than two are found: the largest contact, the
    last frame in contact, and half of the largest. Frames without known fields (or contact) are left out; the list is
    empty if all are.
    """
    usable = _usable_frames(result)
    if not usable.any():
        return []
    frames: list[KeyFrame] = []
    if "normal_force" in result and varies(result, "load_ratio") and not varies(result, "normal_force"):
        frames += _pull_frames(result, usable)
    elif varies(result, "normal_force"):
        frames += _press_frames(result, usable)
    if len(frames) < 2:
        frames += _contact_frames(result, usable)
    chosen: list[KeyFrame] = []
    for frame in frames:  # in order of preference
        apart = all(abs(frame[0] - earlier) > _APART * result.sizes["frame"] for earlier, _ in chosen)
        if apart and len(chosen) < _MOST:
            chosen.append(frame)
    return sorted(chosen)


def _usable_frames(result: xr.Dataset) -> NDArray[np.bool_]:
    """Return a mask (F,) of frames in which any point has a known divergence or, if none was computed, a known
    displacement or position; without all of these, of frames in contact.
    """
    count = result.sizes["frame"]
    for name in ("divergence", "displacement", "position"):
        if name in result and np.isfinite(result[name].values).any():
            return np.isfinite(result[name].values).reshape(count, -1).any(1)
    area = result["gross_contact_area"].values if "gross_contact_area" in result else np.full(count, np.nan)
    return np.nan_to_num(area) > 0


def _press_frames(result: xr.Dataset, usable: NDArray[np.bool_]) -> list[KeyFrame]:
    top = frame_of_largest(result, ("normal_force",), usable)
    if top is None:
        return []
    press = np.where(usable, np.nan_to_num(result["normal_force"].values), 0.0)
    levels = [level for level in LEVELS_N if level < press[top]] or [press[top] * share for share in (0.25, 0.5, 0.75)]
    largest = [(top, "largest force")]
    # Put higher levels first, as they show more and are selected first.
    return largest + [(int(np.argmax(press >= level)), f"{level:.3g} N") for level in reversed(levels)]


def _pull_frames(result: xr.Dataset, usable: NDArray[np.bool_]) -> list[KeyFrame]:
    normal, ratio = result["normal_force"].values, np.abs(result["load_ratio"].values)
    loaded = usable & np.isfinite(ratio) & (np.nan_to_num(normal) > _LOADED * float(np.nanmax(normal)))
    if not loaded.any():
        return []
    top, half = _largest_and_half(np.where(loaded, ratio, -np.inf), "T/N")
    last = int(np.flatnonzero(loaded)[-1])
    between = (top[0] + last) // 2
    return [top, (last, "last frame"), half, *([(between, "sliding")] if usable[between] else [])]


def _contact_frames(result: xr.Dataset, usable: NDArray[np.bool_]) -> list[KeyFrame]:
    area = result["gross_contact_area"].values if "gross_contact_area" in result else np.zeros(len(usable))
    area = np.where(usable, np.nan_to_num(area), 0.0)
    touching = np.flatnonzero(area > 0)
    if not len(touching):
        return [(int(np.flatnonzero(usable)[-1]), "last frame")]
    top, half = _largest_and_half(area, "contact")
    return [top, (int(touching[-1]), "last frame in contact"), half]


def _largest_and_half(values: NDArray[np.floating], name: str) -> list[KeyFrame]:
    """Return two key frames of a time series (F,): where it is largest, and where it first reaches half of that; `name`
    is the name of the series in their reasons.
    """
    top = int(np.argmax(values))
    half = int(np.argmax(values >= values[top] / 2))
    return [(top, f"largest {name}"), (half, f"half of the largest {name}")]
