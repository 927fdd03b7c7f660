"""Detection of wrongly tracked points: share of wrong points found, and share of right points rejected.

Recordings of 320 x 800 px (160 x 400 with --quick), default settings: the shipped press and a slide with even rings of
ridges, which repeat every 15 px; the press of a fingerprint; a press in eight frames, several px from one to the next;
and presses that are disturbed from the middle on (`bench/disturbances.py`): the finger jumps by 5 px, the lens is
out of focus, the light flickers, frames went through a lossy codec.

In the last frames one point in twenty at a time is put beside its place, in any direction, by 1 to 2, 2 to 4, 4 to 8
and 8 to 16 px; `found_1_2` ... is the share of them that fails. Beside it what `process` gives: `wrong` positions more
than 1 px from the truth, in all frames, `wrong_found` how many of them fail, of `right` others `right_dropped`.
check_ms is the median processor time of a check, one thread, for eight frames.
"""

import math
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from bench.disturbances import DISTURBANCES, JUMP_PX, write_disturbed
from bench.environment import one_thread
from bench.recordings import write_quietly
from bench.rows import Row
from fingerflow import load_scene, process
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.synthetic import FingerprintTexture, Press, Slide, SyntheticScene
from fingerflow.tracker.subset_verification import Verification, Verified

SMALL: dict[str, Any] = {"frame_shape": (320, 800), "finger": (5.0, 4.2), "semi_axes": (3.6, 3.1)}
QUICK: dict[str, Any] = {"frame_shape": (160, 400), "finger": (2.7, 2.3), "semi_axes": (2.0, 1.7)}
BESIDE = {"found_1_2": (1, 2), "found_2_4": (2, 4), "found_4_8": (4, 8), "found_8_16": (8, 16)}
WRONG_PX = 1.0
_ONE_IN = 20
_DISTURBED = ("jump", "defocus", "flicker of both", "lossy codec")

Array = np.ndarray[Any, Any]
Check = tuple[Verification, Array, Array, Array, Array]


def run(quick: bool) -> list[Row]:
    """Return a row per recording."""
    size = QUICK if quick else SMALL
    frames = 16 if quick else 48
    usual: dict[str, Any] = {"n_frames": frames, "frame_rate": float(frames), "frames_before_trigger": 2, **size}
    press = Press(**usual)
    recordings: dict[str, SyntheticScene] = {
        "press": press,
        "press of a fingerprint": Press(texture=FingerprintTexture(pattern="loop"), **usual),
        "press in eight frames": Press(**{**usual, "n_frames": 8, "frame_rate": 8.0, "frames_before_trigger": 1}),
        "slide": Slide(**usual),
    }
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for name, scene in recordings.items():
            write_quietly(Path(folder) / name, scene)
            rows.append({"recording": name, **_measured(Path(folder) / name, scene, jump=False)})
        for name in _DISTURBED:
            write_disturbed(Path(folder) / "press", Path(folder) / "disturbed", press, DISTURBANCES[name])
            jump = DISTURBANCES[name].jump
            rows.append({"recording": f"press, {name}", **_measured(Path(folder) / "disturbed", press, jump)})
    return rows


def _measured(folder: Path, scene: SyntheticScene, jump: bool) -> dict[str, float | None]:
    """Return the cells of a row; positions are those of a run without the check."""
    loaded, seconds, last = load_scene(folder / "scene.toml"), list[float](), list[Check]()
    check = Verification.check

    def timed(verification: Verification, *given: Array) -> Verified:
        start = time.process_time()
        found = check(verification, *given)
        seconds.append(time.process_time() - start)
        images, points, status, warp = (np.array(one) for one in given)
        last[:] = [(verification, images, points, status, warp)]
        return found

    def trusting(_: Verification, images: Array, points: Array, *others: Array) -> Verified:
        return Verified.none(points.shape[1])

    with one_thread():
        with patch.object(Verification, "check", timed):
            status = process(loaded, ["status"])["status"].values
        with patch.object(Verification, "check", trusting):
            position = process(loaded, ["position_px"])["position_px"].values
        found = _put_beside(*last[0])
    true = np.stack([scene.truth.follow(position[0], 0, frame) for frame in range(len(position))])
    if jump:
        true[scene.n_frames // 2 :, :, 0] += JUMP_PX
    error = np.linalg.norm(position - true, axis=-1)
    known, fails = np.isfinite(error), status == TrackStatus.WINDOW_DIFFERS
    wrong = known & (error > WRONG_PX)
    return {
        "right": float((known & ~wrong).sum()),
        "right_dropped": float((known & ~wrong & fails).sum()),
        "wrong": float(wrong.sum()),
        "wrong_found": float((wrong & fails).sum()),
        **found,
        "check_ms": 1e3 * statistics.median(seconds),
    }


def _put_beside(
    verification: Verification, images: Array, points: Array, status: Array, warp: Array
) -> dict[str, float | None]:
    """Return the share of displaced points that fail the check, by distance."""
    generator, cells = np.random.default_rng(5), dict[str, float | None]()
    tracked = status[-1] == TrackStatus.TRACKED
    for name, (least, most) in BESIDE.items():
        failed = count = 0
        for first in range(_ONE_IN):
            chosen = np.zeros_like(tracked)
            chosen[first::_ONE_IN] = True
            chosen &= tracked
            angle = 2 * math.pi * generator.random(len(chosen))
            away = least + (most - least) * generator.random(len(chosen))
            shift = away[:, None] * np.stack((np.cos(angle), np.sin(angle)), -1)
            verification.latest = Verified.none(len(chosen))
            moved = np.where(chosen[:, None], points + shift, points).astype(np.float32)
            fails = verification.check(images, moved, status, warp).differs
            failed, count = failed + int((fails & chosen).sum()), count + int(chosen.sum())
        cells[name] = failed / count if count else None
    return cells
