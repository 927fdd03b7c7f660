"""Tests of presses of a finger that touches again with other skin, beside its first contact or over it."""

from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pytest

from bench.contact_grid import energies, skin_in_contact
from bench.recordings import write_quietly
from fingerflow import process
from fingerflow.pipeline.stages.preparation.plausibility import check_energy
from fingerflow.synthetic import Press
from fingerflow.synthetic.texture import RidgeTexture
from tests.silent.contact import PRESS
from tests.small_trials import scene_beside, warnings_of


@dataclass(frozen=True, kw_only=True)
class PressBeside(Press):
    """Press whose contact lies `right` mm to the right of the usual one."""

    right: float = 0.0

    @property
    def contact_centre(self) -> tuple[float, float]:
        x, y = super().contact_centre
        return x + self.right, y


_FRAMES = 45
_SHARED = {field.name: getattr(PRESS, field.name) for field in fields(PRESS)}
_FIRST = replace(PressBeside(**_SHARED), n_frames=_FRAMES, frame_rate=float(_FRAMES), semi_axes=(3.0, 2.5))


@pytest.mark.parametrize("away", [0.0, *(pytest.param(away, marks=pytest.mark.long) for away in (0.6, 2.0))])
def test_energies_of_both_presses(away: float, tmp_path: Path) -> None:
    """Points that were lost when the finger was lifted form no triangles with those of the second press: the energies
    of both are within 3.3 of their deviations, and NaN where most points in contact were seeded there. A
    smooth field explains all frames.
    """
    second = replace(_FIRST, right=away, texture=RidgeTexture(centre=(2.0, 1.5)))
    pictures = []
    for name, press in {"first": _FIRST, "second": second}.items():
        write_quietly(tmp_path / name, press)
        pictures.append(np.load(tmp_path / name / "frames.npy"))
    lifted = np.concatenate([pictures[0], pictures[0][::-2], pictures[1]])
    (tmp_path / "both").mkdir()
    scene = scene_beside(tmp_path / "first", tmp_path / "both", forces=False, stream=False, frames=lifted)
    result = process(scene, ["strain_energy", "strain_energy_std"])
    begins = len(lifted) - _FRAMES
    energy, deviation = (result[f"strain_energy{of}"].values for of in ("", "_std"))
    for press, first in ((_FIRST, 0), (second, begins)):
        frames = [20, 28, 36, 44]
        skin = [skin_in_contact(press, k, 0.1) for k in frames]
        true = [np.nansum(energies(press.truth.gradient(s, k), 0.1)) for s, k in zip(skin, frames, strict=True)]
        at = first + np.array(frames)
        assert (abs(energy[at] - true) < 3.3 * deviation[at]).all()
    assert (np.isnan(energy) == np.isnan(deviation)).all()
    assert "no smooth field explains" not in warnings_of(result)
    (warning,) = check_energy(np.full(2, 50.0), np.array([False, True]), 1.6, 0)
    assert "no smooth field explains the displacements well in 1 frames with contact, the first is 1" in warning
