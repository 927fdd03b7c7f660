"""Sentences that warn the reader of a report about limits of a result."""

import json

import numpy as np
import xarray as xr

_MOST_LOST = 0.2  # largest share of lost points; with more, results describe a selection of the skin
# Largest plausible strain of a triangle; above it, points are wrong or have different onsets of contact.
_LARGE_STRAIN = 0.5
_LARGE_SHARE = 0.02  # share of the triangles whose strain may be larger


def cautions(result: xr.Dataset) -> list[str]:
    """Return cautions about a result: warnings of the run, omitted frames, lost points and implausible strain."""
    warnings = json.loads(result.attrs.get("warnings", "[]"))
    return [*warnings, *_frame_cautions(result), *_point_cautions(result), *_strain_cautions(result)]


def _frame_cautions(result: xr.Dataset) -> list[str]:
    count, sentences = result.sizes["frame"], []
    if "frame_status" in result:
        bad = int((result["frame_status"].values > 0).sum())
        if bad == count:
            sentences.append("No frame of this recording can be used: there are no results. Record it again.")
        elif bad > count / 10:
            sentences.append(f"{bad} of {count} frames are left out ({bad / count:.0%}): curves have gaps there.")
    if "gross_contact_area" in result:
        area = result["gross_contact_area"].values
        if not np.isfinite(area).any():
            sentences.append("No contact area is known in any frame.")
        elif not np.nanmax(area) > 0:
            sentences.append("Nothing touches in any frame: there is no contact to measure.")
        elif "median_divergence" in result:
            touching = np.nan_to_num(area) > 0
            unknown = touching & ~np.isfinite(result["median_divergence"].values)
            if unknown.all() or unknown.sum() > touching.sum() / 10:
                last = int(result["frame"].values[np.flatnonzero(unknown)[-1]])
                none = "strain_energy" in result and bool((result["strain_energy"].values[unknown] == 0).any())
                energy = ", and a strain energy of 0 there means that none is known" if none else ""
                sentences.append(
                    f"In {int(unknown.sum())} of the {int(touching.sum())} frames with contact the deformation is not "
                    f"known, the last is {last}: too few points are followed there{energy}."
                )
    return sentences


def _point_cautions(result: xr.Dataset) -> list[str]:
    if "tracked_share" not in result or "point" not in result.sizes:
        return []
    share = result["tracked_share"].values
    frames_with_points = np.flatnonzero(np.isfinite(share))
    if not len(frames_with_points):
        return []
    worst = int(frames_with_points[np.argmin(share[frames_with_points])])
    if share[worst] > 1 - _MOST_LOST:
        return []
    return [
        f"{1 - share[worst]:.0%} of the {result.sizes['point']} points are lost in frame "
        f"{int(result['frame'].values[worst])}, the worst: medians and maps are those of the others."
    ]


def _strain_cautions(result: xr.Dataset) -> list[str]:
    """Return a caution, in a list, if more triangles between tracked points than expected are strained beyond what skin
    can be; otherwise an empty list.

    Triangles whose points first touched at different times of a slide measure the slide, not the skin.
    """
    if "strain" not in result or not result["strain"].size:
        return []
    largest = np.abs(result["strain"].values).max(-1)
    triangles = np.isfinite(largest).sum(1)
    with np.errstate(invalid="ignore"):
        share = (largest > _LARGE_STRAIN).sum(1) / np.where(triangles, triangles, np.nan)
    if not np.nanmax(share, initial=0.0) > _LARGE_SHARE:
        return []
    first = int(result["frame"].values[int(np.argmax(np.nan_to_num(share) > _LARGE_SHARE))])
    why = "points among them are wrong"
    if "reference_frame" not in result["strain"].attrs:
        why = (
            "displacement counts from the moment each point first touches, and these have points that touched at "
            "different times of a slide; [fields] reference names one frame for all"
        )
    return [
        f"In frame {first} and later, more than {_LARGE_SHARE:.0%} of the triangles are strained by over "
        f"{_LARGE_STRAIN:.0%}, which no skin is: {why}. Their strain, and the strain energy, are not those of the skin."
    ]


def lost_points(result: xr.Dataset) -> list[tuple[str, int]]:
    """Return pairs (reason, number) of the tracked points that have no position in the last usable frame, by the reason
    of their loss, most frequent first.
    """
    if "status" not in result or not result["status"].size:
        return []
    status = result["status"]
    usable = result["frame_status"].values == 0 if "frame_status" in result else np.ones(len(status), dtype=bool)
    if not usable.any():
        return []
    values, counts = np.unique(status.values[int(np.flatnonzero(usable)[-1])], return_counts=True)
    names = str(status.attrs["flag_meanings"]).split()
    lost = [(names[int(value)].replace("_", " "), int(count)) for value, count in zip(values, counts, strict=True)]
    return sorted(((name, count) for name, count in lost if name != "tracked"), key=lambda counted: -counted[1])
