"""Errors of medians and energy divided by their stated standard deviations, on presses at several frame rates.

The results are those of `process` with default settings; the true values come from formulas.

The fewer frames a second, the more is missing before the first frame that shows contact. Eight presses a rate, of which
skin, noise and the moment of the first contact within a frame differ: an error of onset stays to the end, so that all
frames of a press err alike, and one press alone had 1.5 where eight have 1.1. Rows of frames with a median and a truth:
`error` in 1e-3, its mean and RMS; `z` is the error over the stated deviation. Those that hold it have an RMS of one,
68 % of the frames within one deviation and 95 % within two.

Energy, in uJ, is that of all skin in contact, from 10 mm2 of contact on; `percent_rms` and `percent_worst` are errors
over the truth. Five more presses differ in more than that. Energy between points is compared with that of the skin in
the triangles that it is summed over.

Five slides of other skin, a millimetre at 90 Hz, and five that differ in frame rate, way, creep, direction and size of
the contact, once the pull has drawn skin in over the rear rim: of their medians truth counts each skin since its own
entry. What the deviation takes of points that moved in was set on the first five; the others had no part in it.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bench.contact_grid import energy_since_onset, skin_in_contact
from bench.drawing import RED, Mark, draw_dots, saved_axes
from bench.recordings import QUICK_PRESS, processed
from bench.rows import Row, number
from fingerflow.synthetic import ChainPress, FingerprintTexture, Press, RidgeTexture, Slide
from fingerflow.synthetic.scenes import SyntheticScene

RATES, PRESSES = (40.0, 60.0, 300.0), 8  # Hz, of presses of a second
MEDIANS = ("divergence", "curl")
ENERGIES = ("energy", "energy between points")
_COMPARED, _ENERGIES = 40, 8  # frames of a press
_STEP_MM = 0.1
Array = NDArray[np.float64]
ALIKE, SLIDES = "slides", 5
_FROM, _EVERY = 0.4, 3  # share of a slide's time, and step of frames, from which frames are compared
_OF_GRADIENT: dict[str, Callable[[Array], Array]] = {
    "divergence": lambda gradient: gradient[:, 0, 0] + gradient[:, 1, 1],
    "curl": lambda gradient: gradient[:, 1, 0] - gradient[:, 0, 1],
}


class Compared(NamedTuple):
    """Measured values, their stated deviations and the truth, in F frames."""

    measured: Array
    stated: Array
    true: Array


def run(quick: bool) -> list[Row]:
    """Return a row per frame rate and quantity."""
    rows: list[Row] = []
    for presses in [[QUICK_PRESS]] if quick else [_presses(rate) for rate in RATES]:
        found: dict[str, list[Compared]] = {name: [] for name in (*MEDIANS, *ENERGIES)}
        for press in presses:
            result = processed(press)
            for name in MEDIANS:
                found[name].append(_median(result, press, name))
            for name, energies in zip(ENERGIES, _energies(result, press), strict=True):
                found[name].append(energies)
        first = {"what": f"presses, {presses[0].frame_rate:.0f} Hz"}
        rows += [{**first, "quantity": name, **_held(found[name])} for name in MEDIANS]
        rows += [_of_energy({**first, "quantity": name}, found[name]) for name in ENERGIES]
    if quick:
        return rows
    for what, scene in other_presses().items():
        both = _energies(processed(scene), scene)
        rows += [_of_energy({"what": what, "quantity": n}, [one]) for n, one in zip(ENERGIES, both, strict=True)]
    return [*rows, *_of_slides(ALIKE, _alike()), *_of_slides("other slides", _other())]


def _of_energy(first: Row, found: list[Compared]) -> Row:
    measured, _, true = np.concatenate(found, axis=1)
    percent = 100 * (measured / true - 1)
    of_true = {"percent_rms": float(np.sqrt(np.mean(percent**2))), "percent_worst": float(abs(percent).max())}
    return {**first, **_held(found), **of_true}


def strained(press: Press, factor: float) -> Press:
    """Return a press whose displacements are larger by a factor."""
    (xx, xy), (yx, yy) = press.gradient
    bumps = tuple(
        replace(one, shift=(factor * one.shift[0], factor * one.shift[1]), dilation=factor * one.dilation)
        for one in press.bumps
    )
    shift = (factor * press.shift[0], factor * press.shift[1])
    gradient = ((factor * xx, factor * xy), (factor * yx, factor * yy))
    return replace(press, gradient=gradient, shift=shift, bumps=bumps)


def other_presses() -> dict[str, SyntheticScene]:
    press = Press(n_frames=60, frame_rate=60.0)
    return {
        "twice the deformation": strained(press, 2.0),
        "smaller contact": replace(press, texture=RidgeTexture(centre=(1.1, -0.7)), semi_axes=(4.6, 3.6), tilt=-0.6),
        "print with pores": replace(press, texture=FingerprintTexture()),
        "skin chain": ChainPress(n_frames=60, frame_rate=60.0),
        "softer skin chain": ChainPress(n_frames=60, frame_rate=60.0, softness=5.0),
    }


def _of_slides(what: str, slides: list[Slide]) -> list[Row]:
    random = np.random.default_rng(3 if what == ALIKE else 11)
    found: dict[str, list[Compared]] = {name: [] for name in MEDIANS}
    for slide in slides:
        frames = np.arange(int(_FROM * slide.n_frames), slide.n_frames, _EVERY)
        each = [slide.truth.entry_gradient(skin_in_contact(slide, int(k), _STEP_MM), int(k)) for k in frames]
        x, y = random.uniform(-1.5, 1.5, 2)
        result = processed(replace(slide, texture=RidgeTexture(centre=(x, y))))
        for name in MEDIANS:
            true = np.array([np.nanmedian(_OF_GRADIENT[name](one)) for one in each])
            found[name].append(_compared(result, f"median_{name}", frames, true))
    return [{"what": what, "quantity": name, **_held(found[name])} for name in MEDIANS]


def _alike() -> list[Slide]:
    slide = Slide(n_frames=90, frame_rate=90.0, travel=1.0)
    return [replace(slide, camera=replace(slide.camera, seed=seed)) for seed in range(50, 50 + SLIDES)]


def _other() -> list[Slide]:
    slides = (
        Slide(n_frames=60, frame_rate=60.0, travel=1.0),
        Slide(n_frames=90, frame_rate=90.0, travel=2.0, creep=0.5),
        Slide(n_frames=90, frame_rate=90.0, travel=1.0, direction=1.2),
        Slide(n_frames=120, frame_rate=90.0, travel=1.0, creep=1.1, semi_axes=(4.5, 3.8)),
        Slide(n_frames=90, frame_rate=90.0, travel=1.0, direction=-2.5, full_slip=0.7),
    )
    return [replace(one, camera=replace(one.camera, seed=60 + k)) for k, one in enumerate(slides)]


def _presses(rate: float) -> list[Press]:
    press = Press(n_frames=int(rate), frame_rate=rate)
    random = np.random.default_rng(5)
    varied = []
    for seed in range(PRESSES):
        x, y = random.uniform(-1.5, 1.5, 2)
        later = random.uniform(0, 1 / rate)
        varied.append(
            replace(
                press,
                texture=RidgeTexture(centre=(x, y)),
                contact_time=press.contact_time + later,
                rise_time=press.rise_time - later,
                camera=replace(press.camera, seed=seed),
            )
        )
    return varied


def _median(result: xr.Dataset, press: Press, name: str) -> Compared:
    frames = np.arange(0, press.n_frames, max(1, press.n_frames // _COMPARED))
    true = np.array([getattr(press.truth.medians(int(k)), name) for k in frames])
    return _compared(result, f"median_{name}", frames, true)


def _energies(result: xr.Dataset, press: SyntheticScene) -> tuple[Compared, Compared]:
    """Return the energies of the contact, and of the skin in triangles."""
    frames = np.arange(press.n_frames - 1, 0, -max(1, press.n_frames // _ENERGIES))
    frames = frames[[press.truth.gross_contact_area_mm2(int(k)) > 10 for k in frames]]
    contact, between = np.array([energy_since_onset(press, result, int(k), _STEP_MM) for k in frames]).T
    return (
        _compared(result, "strain_energy", frames, contact),
        _compared(result, "strain_energy_between_points", frames, between),
    )


def _compared(result: xr.Dataset, variable: str, frames: NDArray[np.intp], true: Array) -> Compared:
    return Compared(result[variable].values[frames], result[f"{variable}_std"].values[frames], true)


def _held(presses: list[Compared]) -> Row:
    measured, stated, true = np.concatenate(presses, axis=1)
    error = measured - true
    known = np.isfinite(error) & (stated > 0)
    error, z = 1e3 * error[known], error[known] / stated[known]
    return {
        "frames": int(known.sum()),
        "error_mean": float(error.mean()),
        "error_rms": float(np.sqrt(np.mean(error**2))),
        "stated_median": 1e3 * float(np.median(stated[known])),
        "z_rms": float(np.sqrt(np.mean(z**2))),
        "z_worst": float(np.abs(z).max()),
        "within_1": float(np.mean(np.abs(z) < 1)),
        "within_2": float(np.mean(np.abs(z) < 2)),
    }


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw the RMS of error over stated deviation, and the shares of frames within one and two deviations."""
    names = [f"{row['what']}: {row['quantity']}" for row in rows]
    with saved_axes(path, 0.25 * len(rows) + 1, 2, width=9, sharey=True) as (left, right):
        left.axvline(1, color="0.65", linewidth=0.8, zorder=0)
        draw_dots(left, names, {"z": [number(row, "z_rms") for row in rows]}, {"z": Mark(RED)})
        left.set(xlabel="RMS of error / deviation", xlim=(0, None))
        shares = {f"{k} x deviation": [100 * number(row, f"within_{k}") for row in rows] for k in (1, 2)}
        draw_dots(right, names, shares, dict(zip(shares, (Mark(RED, filled=False), Mark(RED)), strict=True)))
        for percent in (68, 95):
            right.axvline(percent, color="0.65", linewidth=0.8, zorder=0)
        right.set(xlabel="frames within (%)", xlim=(None, 101))
        right.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
