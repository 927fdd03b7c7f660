"""Measure the noise floors of displacement and strain from still frames, as the iDICs guide asks (`practice_table`)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr

from fingerflow.errors import FingerflowError
from fingerflow.schema.scene_tables import NoiseFloor, Scene

#: Outputs that `noise_floor` needs.
MEASURED = ("displacement", "divergence", "strain")
_MOVED = 5.0  # scatter of displacements, in their stated deviations, above which skin moves: 1 in still frames


def still_scene(scene: Scene, frames: Path) -> Scene:
    """Return the scene for processing `frames`, a recording in which nothing moves, with the settings of `scene` but
    without forces, and with displacement counted from the first frame.
    """
    recording = replace(scene.recording, frames=frames, trigger_frame=None, first_frame=0, last_frame=None)
    return replace(scene, recording=recording, forces=None, fields=replace(scene.fields, reference="first_frame"))


def noise_floor(result: xr.Dataset, scene: Scene) -> NoiseFloor:
    """Return the noise floor, the standard deviations of displacement, divergence and strain, from the result of a
    recording in which nothing moves; `scene` is that of `still_scene`.

    Deviations of all points and frames after the first count from the mean of all: what moves all points together,
    such as vibration between frames, is part of the noise floor. Both frames contribute, the first and the later one.

    Raises FingerflowError where fewer than two frames or three points are known.
    """
    floor = {}
    for name in MEASURED:
        values = result[name].values[1:].astype(np.float64)
        samples = values.reshape(values.shape[0] * values.shape[1], int(np.prod(values.shape[2:])))
        samples = samples[np.isfinite(samples).all(1)]
        if len(samples) < 3:
            raise FingerflowError(
                f"{scene.recording.frames}: {name} is known {len(samples)} times after the first frame, 3 are needed: "
                "record ten or more frames of skin or a print that rests on the glass from the first frame on"
            )
        floor[name] = float(np.sqrt(samples.var(0, ddof=1).mean()))
    settings = {"window_px": scene.tracking.window_px, "gauge_length_mm": scene.fields.gauge_length_mm}
    return NoiseFloor(floor["displacement"], floor["divergence"], floor["strain"], **settings)


def moved(result: xr.Dataset, floor: NoiseFloor) -> list[str]:
    """Return a warning if points moved by more than the noise of their pictures in the result of `noise_floor`."""
    stated = float(np.sqrt(np.nanmean(np.square(result["displacement_std"].values[1:].astype(np.float64)))))
    if not floor.displacement_mm > _MOVED * stated:
        return []
    return [
        f"points move by {1000 * floor.displacement_mm:.3g} um, and the noise of the pictures explains "
        f"{1000 * stated:.2g} um: this is no noise floor unless the rig vibrates so. Record skin or a print that rests "
        f"on the glass"
    ]
