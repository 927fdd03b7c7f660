"""Automatic calibration from one frame of the registration target and one frame of the scale ring."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fingerflow.calibration.calibration import Calibration
from fingerflow.calibration.discs import find_discs, find_hole
from fingerflow.calibration.edge import Array, Disc
from fingerflow.calibration.registration import Transform, fit_affine, fit_similarity, match_discs
from fingerflow.errors import FingerflowError
from fingerflow.recordings.lens import Lens
from fingerflow.schema.views import View

# Largest number of candidate discs per view. It exceeds the three discs of the target: the target's shape then rejects
# stains and dust.
MOST_DISCS = 9
# Limits for warnings: least axis ratio of the ring's hole, and largest RMS residual of the similarity transform (px).
# The lab's frames have 0.984, and 0.10 and 0.44 px.
LEAST_HOLE_AXIS_RATIO = 0.97
MOST_SIMILARITY_RMS_PX = 1.0
MOST_CENTER_SIGMA_PX = 1.0


def calibrate(
    target: ArrayLike | None,
    ring: ArrayLike,
    views: Mapping[str, View],
    hole_radius_mm: float = 2.75,
    background: ArrayLike | None = None,
    lens: Lens | None = None,
) -> Calibration:
    """Compute the calibration from a frame (H, W) of the registration target and a frame of the scale ring.

    `views` names the parts of a frame: "contact", and "topography" if there is a target. A single-view recording has
    no target (None) and needs the ring alone. `background` is a frame without either. A `lens`, of `fit_lens`, corrects
    the discs and the hole. Raises FingerflowError if a view, a disc or the hole is missing, the discs do not match, or
    the frames differ in size.
    """
    if not (np.isfinite(hole_radius_mm) and hole_radius_mm > 0):
        raise FingerflowError(f"the radius of the ring's hole is {hole_radius_mm} mm; it must be above 0")
    needed = ["contact"] if target is None else ["contact", "topography"]
    missing = [name for name in needed if name not in views]
    if missing:
        raise FingerflowError(
            f"the view {missing[0]!r} is missing; views given: {', '.join(map(repr, views)) or 'none'}. A registration "
            f"target needs 'topography' and 'contact'; a single-view recording has 'contact' and no target"
        )
    inputs = {"ring": ring, "target": target, "background": background}
    frames = {name: np.asarray(frame) for name, frame in inputs.items() if frame is not None}
    for name, frame in frames.items():
        if frame.ndim != 2:
            raise FingerflowError(f"the frame of the {name} is {frame.shape}; a grey one (height, width) is needed")
        if frame.shape != frames["ring"].shape:
            raise FingerflowError(
                f"the frame of the ring has {_size(frames['ring'])} and that of the {name} {_size(frame)}; record all "
                f"calibration frames with the same camera settings"
            )

    def part(name: str, view: str) -> Any:
        return views[view].crop(frames[name]) if name in frames else None

    hole = find_hole(part("ring", "contact"), part("background", "contact"))
    scale = hole_radius_mm / (hole.radius_px if lens is None else _straight_radius(hole, lens, views["contact"]))
    if target is None:
        return Calibration(scale, hole_radius_mm, hole, views, warnings=_warnings(hole, (), None), lens=lens)
    topography = find_discs(part("target", "topography"), part("background", "topography"), MOST_DISCS)
    contact = find_discs(part("target", "contact"), part("background", "contact"), MOST_DISCS)
    pairs = match_discs(topography, contact)
    from_points, to_points = (np.array([pair[side].center for pair in pairs]) for side in (0, 1))
    if lens is not None:
        from_points = lens.straighten(from_points, views["topography"])
        to_points = lens.straighten(to_points, views["contact"])
    similarity = fit_similarity(from_points, to_points)
    return Calibration(
        mm_per_px=scale,
        hole_radius_mm=hole_radius_mm,
        hole=hole,
        views=views,
        discs=tuple(pairs),
        affine=fit_affine(from_points, to_points),
        similarity=similarity,
        warnings=_warnings(hole, tuple(pairs), similarity),
        lens=lens,
    )


def _straight_radius(disc: Disc, lens: Lens, view: View) -> float:
    """Return the radius of the circle with the area of a disc without distortion, px."""
    turn = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    (long, short), cosine, sine = disc.semi_axes_px, np.cos(disc.angle), np.sin(disc.angle)
    edge = np.column_stack((long * np.cos(turn), short * np.sin(turn))) @ ((cosine, sine), (-sine, cosine))
    x, y = (lens.straighten(edge + disc.center, view) - disc.center).T
    area = np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2
    return float(np.sqrt(area / np.pi))


def _size(frame: Array) -> str:
    return f"{frame.shape[0]} rows x {frame.shape[1]} columns"


def _warnings(hole: Disc, pairs: tuple[tuple[Disc, Disc], ...], similarity: Transform | None) -> tuple[str, ...]:
    warnings = []
    if hole.axis_ratio < LEAST_HOLE_AXIS_RATIO:
        warnings.append(
            f"the hole of the ring is an ellipse, axes {hole.axis_ratio:.3f} to 1: the scale differs by direction; is "
            f"the ring flat on the glass?"
        )
    if similarity is not None and similarity.rms_px > MOST_SIMILARITY_RMS_PX:
        warnings.append(
            f"the views differ by more than rotation, scale and shift: {similarity.rms_px:.2f} px remain; one of them "
            f"is oblique, or the lens distorts, which a calibration with a chessboard corrects"
        )
    for name, side in (("topography", 0), ("contact", 1)):
        for disc in (pair[side] for pair in pairs):
            if disc.center_sigma_px > MOST_CENTER_SIGMA_PX:
                warnings.append(
                    f"the centre of the disc at ({disc.center[0]:.0f}, {disc.center[1]:.0f}) px of the {name} view is "
                    f"uncertain by {disc.center_sigma_px:.2f} px: its edge is ragged or blurred"
                )
    return tuple(warnings)
