"""Faults of a lab in a simulated press: a jump, flicker, defocus and a lossy codec, from its middle on.

The finger jumps by 5 px between two frames and stays there; the light of both views flickers by 20 %, as a lamp does
whose phase runs along with the frames; the lens is out of focus by 0.5 px (standard deviation of the blur); frames went
through a lossy codec (JPEG of quality 85, in blocks of 8 px). All but the codec come before the noise of the camera.
"""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from fingerflow.synthetic import Press

JUMP_PX = 5
FLICKER = 0.2
BLUR_PX = 0.5
JPEG_QUALITY = 85

Picture = NDArray[np.floating]


class Disturbance(NamedTuple):
    """Changes of the light before the camera, or of its frames; `jump` if the finger moves to another place."""

    light: Callable[[Picture, int, Press], Picture] | None = None
    frame: Callable[[NDArray[np.integer]], NDArray[np.integer]] | None = None
    jump: bool = False


def _jump(picture: Picture, frame: int, press: Press) -> Picture:
    if frame < press.n_frames // 2:
        return picture
    glass = press.views["contact"].crop(press.empty_clean())
    # The finger moves, and the light on the glass does not.
    left = np.roll(press.views["contact"].crop(picture) / glass, JUMP_PX, axis=1)
    skin = np.roll(press.views["topography"].crop(picture), JUMP_PX, axis=1)
    return np.concatenate([skin, left * glass], axis=1)


def _flicker(picture: Picture, frame: int, press: Press) -> Picture:
    return picture * float(1 + FLICKER * np.sin(2.4 * frame))  # about 115 Hz in 300 frames/s


def _defocus(picture: Picture, frame: int, press: Press) -> Picture:
    if frame < press.n_frames // 2:
        return picture
    blurred = [
        cv2.GaussianBlur(np.ascontiguousarray(press.views[name].crop(picture)), (0, 0), BLUR_PX)
        for name in ("topography", "contact")
    ]
    return np.concatenate(blurred, axis=1)


def _codec(frame: NDArray[np.integer]) -> NDArray[np.integer]:
    done, coded = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    assert done
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE), dtype=frame.dtype)


DISTURBANCES = {
    "jump": Disturbance(light=_jump, jump=True),
    "flicker of both": Disturbance(light=_flicker),
    "defocus": Disturbance(light=_defocus),
    "lossy codec": Disturbance(frame=_codec),
}


def write_disturbed(recording: Path, folder: Path, press: Press, disturbance: Disturbance) -> None:
    """Write a recording of the press again, with a disturbance, into another folder, which is replaced."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(recording, folder)
    frames = np.lib.format.open_memmap(folder / "frames.npy", mode="r+")
    for number in range(press.n_frames):
        if disturbance.light is not None:
            light = torch.from_numpy(disturbance.light(press.render_clean(number), number, press))
            frames[number] = press.camera.read_out(light, number, defects=press.views["contact"])
        elif disturbance.frame is not None:
            frames[number] = disturbance.frame(frames[number])
    frames.flush()
