"""Errors of every quantity with a stated standard deviation, divided by it, on presses and slides of real prints.

The number is the RMS of error over deviation, and the share of the errors within one and two deviations, 68 and 95 %
where errors are normal. A row is a quantity, recorded (`process` with default settings) or live (records of a stream of
the native engine), on all scenes of a kind. Truth follows from the formulas of the scene.
"""

import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
import xarray as xr
from scipy.stats import binom, chi2

from bench.contact_grid import energies, energy_since_onset, skin_in_contact
from bench.prints import FINGERS
from bench.recordings import write_quietly
from fingerflow import process
from fingerflow.engines.engine import Array
from fingerflow.kernels.library import is_present
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.ops.fields.rigid_motion import rigid_residual
from fingerflow.ops.fields.strain import green_lagrange, principal_strains, shear, strain_energy_density
from fingerflow.ops.fields.triangles import triangle_gradients
from fingerflow.schema.variables import ENTRY
from fingerflow.synthetic import ChainPress, PartialSlip, Press
from fingerflow.synthetic.scenes import SyntheticScene
from tests.silent.case import Case, played
from tests.silent.deviation_scenes import scenes

Errors = dict[str, tuple[Array, Array]]
InFrames = dict[str, list[tuple[Array, Array]]]

_PRESSES = Press, ChainPress
_KINDS = {Press: "presses", ChainPress: "chain presses"}
GOALS = np.array(((0.8, 0.60, 0.92), (1.25, 0.76, 0.98)))  # least and most
_FEW = 1000  # values of a row, up to which those of a scene are taken as correlated
_TAILS = np.array((0.025, 0.975))
_FRAMES = 7  # of a scene, that are compared
# Steps of the grids of true medians and energies: on presses, whose strain rises to the border, and on slides.
_STEPS_MM = 0.07, 0.15
_LEAST_MM2 = 10.0  # contact from which medians and energies are compared
_STRAINS = ("exx", "eyy", "exy")
_OPTIONAL = "shear", "rigid_residual", "principal_strains", "principal_angle"
_FIELDS = "divergence", "curl", "point_strain"
_AT_POINTS = "position_px", "position_std_px", "entered", *_FIELDS, *(f"{name}_std" for name in _FIELDS)


def cases() -> Iterator[Case]:
    """Yield a case for each quantity, recorded and live, on the presses and on the slides."""
    if not FINGERS.is_dir():
        print(f"no cases of real prints: {FINGERS} is not here")
        return
    yield from judged(scenes())


def judged(some: Iterator[tuple[str, SyntheticScene]]) -> Iterator[Case]:
    """Yield a case for each quantity of some scenes."""
    found: dict[str, list[Array]] = defaultdict(list)
    for _, scene in some:
        kind = _KINDS.get(type(scene), "slides")
        with tempfile.TemporaryDirectory() as folder:
            recording = Path(folder) / "recording"
            write_quietly(recording, scene)
            outputs = [*_OPTIONAL, *(() if isinstance(scene, _PRESSES) else ("stuck_area",))]
            recorded = compared(process(recording / "scene.toml", outputs), scene)
            live = of_stream(recording, scene) if is_present() else {}
        for of, errors in ((kind, recorded), (f"{kind}, live", live)):
            for name, parts in errors.items():
                found[f"{of}: {name}"].append(np.concatenate([np.reshape(part, (2, -1)) for part in parts], 1))
    yield from (case_of(name, scenes) for name, scenes in found.items())


def case_of(name: str, scenes: list[Array]) -> Case:
    """Judge errors of S scenes by their stated deviations, (2, n) each; those that are NaN do not count.

    Values of a scene correlate. Up to `_FEW` values of a row tell as much as the variance of |z| over that of its mean,
    by scenes, of independent ones, at least S. A row out of the goal is judged where that many normal errors of the
    stated deviation have such a spread or share with a probability below 5 %.
    """
    scenes = [one[:, np.isfinite(one).all(0) & (one[1] > 0)] for one in scenes]
    error, stated = np.concatenate(scenes, 1)
    z, count = abs(error / stated), len(error)
    if not count:
        return Case(name, "none", "", "", "no deviation is stated")
    found = np.array((np.mean(z**2) ** 0.5, np.mean(z < 1), np.mean(z < 2)))
    low, high = GOALS
    out = (found < low) | (found > high)
    if count <= _FEW:
        of_mean = sum(np.sum(abs(one[0] / one[1]) - z.mean()) ** 2 for one in scenes) / count**2
        count = int(np.clip(z.var() / of_mean, len(scenes), count))
        spread, *shares = chi2.ppf(_TAILS, count), *(binom.ppf(_TAILS, count, share) for share in (0.683, 0.954))
        low, high = np.transpose((np.sqrt(spread / count), *(np.array(shares) / count)))
    told = out & ((found < low) | (found > high))
    verdict = "cannot be told" if out.any() else "holds"
    if told.any():
        verdict = "too small" if found[0] > 1 else "too large"
    sizes = f"{len(z)} values as {count}, median {np.median(stated):.2g}, error {np.mean(error**2) ** 0.5:.2g}"
    return Case(name, "z {:.2f}, {:.0%}, {:.0%}".format(*found), "z 1, 68%, 95%", sizes, verdict)


def compared(result: xr.Dataset, scene: SyntheticScene) -> InFrames:
    """Return errors and stated deviations of a result in frames, by quantity."""
    skin = _Skin(result, scene, material_of(result["position_px"].values, scene))
    found: InFrames = defaultdict(list)
    for frame in np.unique(np.linspace(1, scene.n_frames - 1, _FRAMES).astype(int)).tolist():
        for name, one in (skin.at(frame) | _of_contact(result, scene, frame)).items():
            found[name].append(one)
    if isinstance(scene, _PRESSES):
        onset, true = result["onset_frame"].values, scene.truth.onset_frame(skin.material)
        error = np.where(skin.known & (onset > 0) & (true > 0), onset - true, np.nan)
        found["onset_frame"].append((error, result["onset_frame_std"].values))
    return found


def material_of(position_px: Array, scene: SyntheticScene) -> Array:
    """Return material coordinates (N, 2) of points from their positions (frames, N, 2) px where each was seeded."""
    first = np.isfinite(position_px).all(-1).argmax(0)
    result = np.full(position_px.shape[1:], np.nan)
    for frame in np.unique(first):
        some = first == frame
        places = scene.truth.topography_positions(position_px[frame, some])
        known = np.isfinite(places).all(-1)
        result[np.flatnonzero(some)[known]] = scene.truth.material(places[known], int(frame))
    return result


class _Skin:
    """True positions, displacements and fields of the points of a result."""

    def __init__(self, result: xr.Dataset, scene: SyntheticScene, material: Array) -> None:
        self.result, self.scene, self.truth = result, scene, scene.truth
        self.known = np.isfinite(material).all(-1)
        self.material = np.where(self.known[:, None], material, scene.contact_centre)
        self.entered = result["entry"].values == ENTRY.index("entered")
        self.triangles = result["triangles"].values
        # Triangles that times of onset distort count from the last of them, in which they have no strain.
        self.begins = result["onset_frame"].values[self.triangles].max(1, initial=0)
        self.from_frame = (result["strain"].values[self.begins, range(len(self.begins))] == 0).all(1)
        self.known &= result["entry"].values != ENTRY.index("seeded_inside")

    def at(self, frame: int) -> Errors:
        """Return errors and deviations of points and triangles in a frame."""
        result, truth = self.result, self.truth
        known = self.known[:, None]
        position = np.where(known, truth.topography_pixels(truth.positions(self.material, frame)), np.nan)
        tracked = (result["status"].values[frame] == TrackStatus.TRACKED)[:, None]
        # A point that was seeded in this frame has no error.
        stated = np.where(tracked, result["position_std_px"].values[frame][:, None], np.nan).repeat(2, 1)
        moved = np.where(known, truth.displacement(self.material, frame), np.nan)
        errors = {
            "position": (result["position_px"].values[frame] - position, stated),
            "displacement": (
                result["displacement"].values[frame] - moved,
                result["displacement_std"].values[frame][:, None].repeat(2, 1),
            ),
        }
        gradient = self.gradient(frame)
        for name, true in fields_of(gradient).items():
            errors[name] = (result[name].values[frame] - true, result[f"{name}_std"].values[frame])
        true_strain = self._strain(moved, frame)
        density = strain_energy_density(torch.from_numpy(true_strain)).numpy()
        measured, stated = (result[f"strain_energy_density{of}"].values[frame] for of in ("", "_std"))
        errors["strain_energy_density"] = measured - density, stated
        principal, angle = (part.numpy() for part in principal_strains(torch.from_numpy(true_strain)))
        turned = result["principal_angle"].values[frame] - angle
        errors["principal_angle"] = np.arctan(np.tan(turned)), result["principal_angle_std"].values[frame]
        true = {"shear": shear(torch.from_numpy(gradient)).numpy(), "principal_strains": principal}
        for name, field in true.items():
            errors[name] = result[name].values[frame] - field, result[f"{name}_std"].values[frame]
        errors |= self._not_rigid(moved, frame)
        strain = result["strain"].values[frame] - true_strain
        for column, name in enumerate(_STRAINS):
            errors[f"strain {name}"] = strain[:, column], result["strain_std"].values[frame][:, column]
        return errors

    def _not_rigid(self, moved: Array, frame: int) -> Errors:
        """Return errors and deviations of what the best rigid motion leaves of the true displacements `moved` (N, 2) of
        the same points.
        """
        result, reference = self.result, self.truth.positions(self.material, frame) - moved
        residual, stated = (result[f"rigid_residual{of}"].values[frame] for of in ("", "_std"))
        counted = np.where(np.isfinite(residual), moved, np.nan)
        true = rigid_residual(*(torch.from_numpy(values)[None] for values in (reference, counted)))[0].numpy()
        median, of_median = (result[f"rigid_residual_median{of}"].values[frame] for of in ("", "_std"))
        length = np.nanmedian(np.hypot(*true.T)) if np.isfinite(true).any() else np.nan
        return {
            "rigid_residual": (residual - true, stated[:, None].repeat(2, 1)),
            "rigid_residual_median": (np.array([median - length]), np.array([of_median])),
        }

    def gradient(self, frame: int) -> Array:
        """Return the true displacement gradients (N, 2, 2); of points that moved in, since their own entry."""
        since_onset = self.truth.gradient(self.material, frame)
        since_entry = self.truth.entry_gradient(self.material, frame)
        result = np.where(self.entered[:, None, None], since_entry, since_onset)
        return np.where(self.known[:, None, None], result, np.nan)

    def _strain(self, moved: Array, frame: int) -> Array:
        """Return the true strains (M, 3) of triangles; NaN for triangles that have another reference.

        On a press they count from the true onsets of their corners, or from a frame where these distort them; on a
        slide from a frame, as those that touch in the first. Triangles with skin that moved in count from the last of
        three entries, and are left out.
        """
        now = self.truth.positions(self.material, frame)
        skin, reference = now[self.triangles], (now - moved)[self.triangles]
        if not isinstance(self.scene, _PRESSES):
            reference[:] = np.nan
        for begin in np.unique(self.begins[self.from_frame]):
            some = self.from_frame & (self.begins == begin)
            reference[some] = self.truth.positions(self.material, begin)[self.triangles[some]]
        points, change = (torch.from_numpy(one.reshape(1, -1, 2)) for one in (reference, skin - reference))
        each = torch.arange(3 * len(skin)).reshape(-1, 3)
        strain = green_lagrange(triangle_gradients(points, each, change))[0].numpy()
        return np.where(self.entered[self.triangles].any(1, keepdims=True), np.nan, strain)


def _of_contact(result: xr.Dataset, scene: SyntheticScene, frame: int) -> Errors:
    """Return errors and deviations of areas, medians and energies in a frame, none where nothing touches."""
    gross, real = scene.truth.gross_contact_area_mm2(frame), scene.truth.real_contact_area_mm2(frame)
    if not gross and not result["real_contact_area"].values[frame]:
        return {}
    true: dict[str, Any] = {"gross_contact_area": gross, "real_contact_area": real}
    grows = isinstance(scene, _PRESSES)
    step = _STEPS_MM[not grows]
    ellipse = scene.truth.ellipse(frame)
    if gross > _LEAST_MM2 and ellipse is not None:
        true |= {"contact_area_ratio": real / gross, "ellipse_center": ellipse.centre}
        true["ellipse_semi_axes"] = sorted(ellipse.semi_axes, reverse=True)
        # Since the onset on a press, since its own entry of skin that slides.
        gradient = (scene.truth.gradient if grows else scene.truth.entry_gradient)(
            skin_in_contact(scene, frame, step), frame
        )
        true |= {f"median_{name}": value for name, value in medians_of(gradient).items()}
        if "strain_energy" not in result:
            pass  # a stream has none
        elif grows:
            names = "strain_energy", "strain_energy_between_points"
            true |= dict(zip(names, energy_since_onset(scene, result, frame, step), strict=True))
        else:
            true["strain_energy"] = float(np.nansum(energies(gradient, step)))
    if isinstance(scene, PartialSlip) and "stuck_ratio" in result:
        true |= {"stuck_ratio": scene.stuck_share(frame), "stuck_area": gross * scene.stuck_share(frame)}
    errors = {}
    for name, value in true.items():
        variable, _, component = name.partition(" ")
        index = [_STRAINS.index(component)] if component else []
        measured, stated = (result[one].values[frame, *index] for one in (variable, f"{variable}_std"))
        errors[name] = np.array([measured - value]), np.array([stated])
    return errors


def medians_of(gradient: Array) -> dict[str, float]:
    """Return the medians of divergence, curl and strain components over displacement gradients (N, 2, 2)."""
    strain = green_lagrange(torch.from_numpy(gradient)).numpy()
    fields = fields_of(gradient) | {f"strain {name}": strain[:, column] for column, name in enumerate(_STRAINS)}
    return {name: float(np.nanmedian(one)) for name, one in fields.items()}


def of_stream(recording: Path, scene: SyntheticScene) -> InFrames:
    """Return errors and stated deviations of the results of a stream in frames, by quantity."""
    result, truth, found = played(recording / "scene.toml"), scene.truth, defaultdict(list)
    seeded_last = np.flatnonzero(result["restart"] == result["restart"][-1])
    material = material_of(result["position_px"].values[seeded_last], scene) if seeded_last[0] == 0 else None
    for frame in np.unique(np.linspace(1, scene.n_frames - 1, _FRAMES).astype(int)).tolist():
        if material is not None:
            some = np.isfinite(material).all(-1) & (result["status"].values[frame] == TrackStatus.TRACKED)
            now = {name: result[name].values[frame][some] for name in _AT_POINTS}
            true = truth.topography_pixels(truth.positions(material[some], frame))
            found["position"].append((now["position_px"] - true, now["position_std_px"][:, None].repeat(2, 1)))
            since = [of(material[some], frame) for of in (truth.gradient, truth.entry_gradient)]
            gradient = np.where(now["entered"][:, None, None], since[1], since[0])
            strain = green_lagrange(torch.from_numpy(gradient)).numpy()
            for name, field in (fields_of(gradient) | {"point_strain": strain}).items():
                found[name].append((now[name] - field, now[f"{name}_std"]))
        for name, one in _of_contact(result, scene, frame).items():
            found[name].append(one)
    return found


def fields_of(gradient: Array) -> dict[str, Array]:
    """Return divergence and curl (N,) of displacement gradients (N, 2, 2)."""
    return {"divergence": gradient[:, 0, 0] + gradient[:, 1, 1], "curl": gradient[:, 1, 0] - gradient[:, 0, 1]}
