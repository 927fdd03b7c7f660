"""A press of a real fingerprint, in the files that a lab has before any setting is known."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from fingerflow.schema.views import View
from fingerflow.synthetic import Press, SyntheticScene, scene_of_print
from fingerflow.synthetic.scenes import FORCE_RATE
from tests.calibration.drawn_discs import DrawnDisc, camera, draw, moved

FRAMES = 40
DPI = 569.0  # resolution of FVC2002 DB2
RATE = 40.0  # Hz
TRIGGER_FRAME = 2
HOLE_RADIUS_MM = 2.75
#: The views in the frame of the camera, between margins without light.
VIEWS = {"topography": View((10, 522), (12, 652)), "contact": View((10, 522), (668, 1308))}
FRAME_SHAPE = (528, 1320)
_DISCS = (DrawnDisc(250, 150, 60, 60), DrawnDisc(430, 200, 45, 45), DrawnDisc(300, 380, 45, 45))  # px, contact view
_GRAM_FORCE = 9.80665e-3  # N
_LONGER = 1000  # samples of the force sensors before and after the recording
_BRIGHT, _DARK = 150.0, 60.0


def press_of(fingerprint: Path) -> SyntheticScene:
    """Return the press of `make demo` in 40 frames, with the skin of a picture of a real fingertip."""
    return replace(
        scene_of_print(Press, fingerprint, DPI), n_frames=FRAMES, frame_rate=RATE, frames_before_trigger=TRIGGER_FRAME
    )


def write_raw_press(folder: Path, scene: SyntheticScene) -> None:
    """Write press.tif; empty.tif and dark.tif with 8 frames each; ring.tif and target.tif; forces.csv.

    The force is in gram-force and negative while the finger presses. The discs of the target and the hole of the ring
    follow the scale and the transform of the scene.
    """
    folder.mkdir()
    dark = int(np.round(scene.dark().mean()))
    for name, frames in {
        "press": (scene.render(k) for k in range(scene.n_frames)),
        "empty": (scene.empty(k) for k in range(8)),
        "dark": (scene.dark(k) for k in range(8)),
    }.items():
        tifffile.imwrite(folder / f"{name}.tif", np.stack([_in_frame(one, dark) for one in frames]))
    shape = scene.views["contact"].shape
    to_topography = cv2.invertAffineTransform(np.array(scene.topography_to_contact))
    discs = {"topography": moved(_DISCS, to_topography), "contact": _DISCS}
    hole = DrawnDisc(330, 260, HOLE_RADIUS_MM / scene.mm_per_px, HOLE_RADIUS_MM / scene.mm_per_px)
    blank = np.full(shape, _BRIGHT)
    target = [camera(draw(discs[name], shape, _BRIGHT, _DARK), 2.0, k) for k, name in enumerate(discs)]
    ring = [camera(blank, 2.0, 3), camera(draw((hole,), shape, _BRIGHT, _DARK), 2.0, 4)]
    for name, views in {"target": target, "ring": ring}.items():
        tifffile.imwrite(folder / f"{name}.tif", _in_frame(np.concatenate(views, axis=1), dark))
    # The force sensors are read for longer than the camera.
    _, normal, tangential, trigger = (np.pad(one, _LONGER, mode="edge") for one in scene.forces())
    time = np.arange(len(normal)) / FORCE_RATE
    columns = np.stack((time, -normal / _GRAM_FORCE, tangential / _GRAM_FORCE, trigger), axis=1)
    heading = "time (s),normal_force (gf),tangential_force (gf),trigger (V)"
    np.savetxt(folder / "forces.csv", columns, fmt="%.5f", delimiter=",", header=heading, comments="")


def _in_frame(views: NDArray[np.integer], level: int) -> NDArray[np.integer]:
    """Return a frame of the camera (H, W) with both views in their places, from the views side by side."""
    half = views.shape[1] // 2
    frame = np.full(FRAME_SHAPE, level, dtype=views.dtype)
    for view, part in zip(("topography", "contact"), (views[:, :half], views[:, half:]), strict=True):
        (top, bottom), (left, right) = VIEWS[view].rows, VIEWS[view].columns
        frame[top:bottom, left:right] = part
    return frame
