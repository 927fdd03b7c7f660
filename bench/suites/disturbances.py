"""Errors of the results when a simulated press has faults that occur in a lab; default settings.

300 frames of two 512 x 640 px views (24 small ones with --quick), disturbed before the camera adds its noise: in the
middle of the recording the finger jumps by 5 px between two frames and stays there; the light of one view or of both
flickers by 20 %, as a lamp does whose phase runs along with the frames; from the middle on the lens is out of focus by
0.5 px (standard deviation of the blur); a twentieth of the frames is missing; frames went through a lossy codec (JPEG
of quality 85, in blocks of 8 px).

Against the exact truth, in every fifth frame: `tracked` is the share of points that have a position, `wrong` that of
positions off by more than 0.3 px, position_px their RMS and worst_px the largest; areas in percent and the median
divergence, RMS over the frames in which the gross contact has an eighth of its final area or more. energy_pct is the
strain energy of the last frame against that of the recording without a disturbance; not of the jump, by which skin that
touched before it is strained against skin that touches later. `warnings` is how many there are; `refused` is why there
is no result.
"""

import json
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
import xarray as xr
from numpy.typing import NDArray

from bench.recordings import QUICK_PRESS, write_quietly
from bench.rows import Row
from fingerflow import load_scene, process
from fingerflow.errors import FingerflowError
from fingerflow.synthetic import Press

WRONG_PX = 0.3
JUMP_PX = 5
FLICKER = 0.2
BLUR_PX = 0.5
JPEG_QUALITY = 85
OUTPUTS = ["real_contact_area", "gross_contact_area", "position_px", "median_divergence", "strain_energy"]

Picture = NDArray[np.floating]


class Disturbance(NamedTuple):
    """Changes of the light before the camera and of its frames; `missing` is the share of missing frames."""

    light: Callable[[Picture, int, Press], Picture] | None = None
    frame: Callable[[NDArray[np.integer]], NDArray[np.integer]] | None = None
    jump: bool = False
    missing: float = 0.0


def _jump(picture: Picture, frame: int, press: Press) -> Picture:
    if frame < press.n_frames // 2:
        return picture
    glass = press.views["contact"].crop(press.empty_clean())
    # The finger moves, and the light on the glass does not.
    left = np.roll(press.views["contact"].crop(picture) / glass, JUMP_PX, axis=1)
    skin = np.roll(press.views["topography"].crop(picture), JUMP_PX, axis=1)
    return np.concatenate([skin, left * glass], axis=1)


def _flicker(*views: str) -> Callable[[Picture, int, Press], Picture]:
    def light(picture: Picture, frame: int, press: Press) -> Picture:
        picture = picture.copy()
        for name in views:
            part = press.views[name].crop(picture)
            part *= 1 + FLICKER * np.sin(2.4 * frame)  # about 115 Hz in 300 frames/s
        return picture

    return light


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
    "none": Disturbance(),
    "jump": Disturbance(light=_jump, jump=True),
    "flicker of the contact view": Disturbance(light=_flicker("contact")),
    "flicker of the topography": Disturbance(light=_flicker("topography")),
    "flicker of both": Disturbance(light=_flicker("contact", "topography")),
    "defocus": Disturbance(light=_defocus),
    "missing frames": Disturbance(missing=0.05),
    "lossy codec": Disturbance(frame=_codec),
}


def run(quick: bool) -> list[Row]:
    """Return a row per disturbance."""
    return rows_of(QUICK_PRESS if quick else Press(), DISTURBANCES)


def rows_of(press: Press, disturbances: dict[str, Disturbance]) -> list[Row]:
    """Return the rows of disturbances, the first of which is none."""
    rows: list[Row] = []
    energy = float("nan")
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "press"
        write_quietly(recording, press)
        for name, disturbance in disturbances.items():
            kept = write_disturbed(recording, Path(folder) / "disturbed", press, disturbance)
            try:
                result = process(load_scene(Path(folder) / "disturbed" / "scene.toml"), OUTPUTS, device="cpu")
            except FingerflowError as error:
                rows.append({"disturbance": name, "refused": str(error).partition(": ")[2].partition(".")[0]})
                continue
            last = float(result["strain_energy"][-1])
            energy = last if not rows else energy
            errors = _errors(result, press, kept, disturbance.jump)
            warnings = len(json.loads(result.attrs["warnings"]))
            cost = None if disturbance.jump else 100 * (last / energy - 1)
            rows.append({"disturbance": name, **errors, "energy_pct": cost, "warnings": warnings, "refused": None})
    return rows


def write_disturbed(recording: Path, folder: Path, press: Press, disturbance: Disturbance) -> NDArray[np.intp]:
    """Write the press with a disturbance; return the numbers of its frames."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(recording, folder, ignore=shutil.ignore_patterns("frames.npy"))
    kept = np.arange(press.n_frames)
    first = press.n_frames // 2
    kept = np.delete(kept, slice(first, first + round(disturbance.missing * press.n_frames)))
    plain = np.load(recording / "frames.npy", mmap_mode="r")
    frames = np.lib.format.open_memmap(
        folder / "frames.npy", mode="w+", dtype=plain.dtype, shape=(len(kept), *plain.shape[1:])
    )
    for place, number in enumerate(kept.tolist()):
        if disturbance.light is None:
            frames[place] = plain[number] if disturbance.frame is None else disturbance.frame(plain[number])
        else:
            light = torch.from_numpy(disturbance.light(press.render_clean(number), number, press))
            frames[place] = press.camera.read_out(light, number, defects=press.views["contact"])
    frames.flush()
    scene = folder / "scene.toml"
    scene.write_text(scene.read_text().replace(f"last_frame = {press.n_frames - 1}", f"last_frame = {len(kept) - 1}"))
    return kept


def _errors(result: xr.Dataset, press: Press, kept: NDArray[np.intp], jump: bool) -> dict[str, float]:
    truth = press.truth
    position = result["position_px"].values
    gross = truth.gross_contact_area_mm2(press.n_frames - 1)
    distances, areas, divergence = [], [], []
    for place in range(len(kept) - 1, 0, -5):
        frame = int(kept[place])
        true = truth.follow(position[0], 0, frame)
        if jump and frame >= press.n_frames // 2:
            true = true + np.array([JUMP_PX, 0.0])
        distances.append(np.linalg.norm(position[place] - true, axis=-1))
        if truth.gross_contact_area_mm2(frame) > gross / 8:
            areas.append(
                [
                    float(result[f"{kind}_contact_area"][place]) / area - 1
                    for kind, area in (
                        ("real", truth.real_contact_area_mm2(frame)),
                        ("gross", truth.gross_contact_area_mm2(frame)),
                    )
                ]
            )
            divergence.append(float(result["median_divergence"][place]) - truth.medians(frame).divergence)
    distance = np.array(distances)
    found = distance[np.isfinite(distance)]
    real_pct, gross_pct = 100 * np.sqrt(np.square(areas).mean(0))
    return {
        "tracked": found.size / distance.size,
        "wrong": float((found > WRONG_PX).mean()),
        "position_px": float(np.sqrt((found**2).mean())),
        "worst_px": float(found.max()),
        "real_area_pct": float(real_pct),
        "gross_area_pct": float(gross_pct),
        "divergence_um_mm": 1e3 * float(np.sqrt(np.square(divergence).mean())),
    }
