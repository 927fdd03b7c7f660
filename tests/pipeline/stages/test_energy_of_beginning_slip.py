"""Strain energy in the frames in which slip begins, in a strip along the border that is narrower than a window."""

import numpy as np
import pytest

from bench.contact_grid import energies, skin_in_contact
from bench.prints import FINGERS
from bench.recordings import processed
from tests.silent.deviation_scenes import scenes


@pytest.mark.long
@pytest.mark.skipif(not FINGERS.is_dir(), reason=f"{FINGERS} with real prints is not here")
def test_windows_that_match_badly_beside_slip_are_no_noise() -> None:
    """The energy of image noise is subtracted from the strain energy; that of mismatched windows is not."""
    scene = dict(scenes())["slide 0 of 101_1"]
    result, frames = processed(scene, ["strain_energy"]), np.arange(14, 22)
    gradients = [scene.truth.entry_gradient(skin_in_contact(scene, k, 0.1), k) for k in frames.tolist()]
    true = np.array([energies(gradient, 0.1).sum() for gradient in gradients])
    energy, deviation = (result[name].values[frames] for name in ("strain_energy", "strain_energy_std"))
    assert (energy > 0.6 * true).all()
    assert (abs(energy - true) < 2 * deviation).all()
