"""True area-based quantities and strain energy of a synthetic scene, by formulas on a dense grid of skin points."""

import numpy as np
import torch
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from fingerflow.ops.fields.strain import green_lagrange, strain_energy_density
from fingerflow.synthetic.scenes import SyntheticScene

DEPTH_MM = 2.0  # fields.depth_mm, by default
Array = NDArray[np.float64]


def skin_in_contact(scene: SyntheticScene, frame: int, step_mm: float) -> Array:
    """Return material positions (N, 2) mm of the skin on a grid over the contact in a frame."""
    ellipse = scene.truth.ellipse(frame)
    assert ellipse is not None
    axis = np.arange(-10, 10, step_mm)
    places = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2) + ellipse.centre
    inside = (ellipse.distance(*torch.from_numpy(places).unbind(-1)) > 0).numpy()
    return np.asarray(scene.truth.material(places[inside], frame))


def energies(gradient: Array, step_mm: float) -> Array:
    """Compute strain energies (N,) mJ from displacement gradients (N, 2, 2) on a grid in their own frame.

    The density refers to the reference volume, as that of triangles does.
    """
    density = strain_energy_density(green_lagrange(torch.from_numpy(gradient))).numpy()
    result: Array = DEPTH_MM * density / np.linalg.det(np.eye(2) + gradient) * step_mm**2
    return result


def energy_since_onset(scene: SyntheticScene, result: xr.Dataset, frame: int, step_mm: float) -> tuple[float, float]:
    """Compute the energy since the onset, mJ: of all skin in contact, and of that in the triangles of ``result``."""
    material = skin_in_contact(scene, frame, step_mm)
    each = energies(scene.truth.gradient(material, frame), step_mm)
    places = scene.truth.positions(material, frame) - scene.truth.displacement(material, frame)
    reference, onset = result["reference_position"].values, result["onset_frame"].values
    known = np.flatnonzero(np.isfinite(reference).all(1))
    mesh = Delaunay(reference[known])
    corners = known[mesh.simplices]
    counts = (onset[corners] >= 0).all(1) & (onset[corners].max(1) <= frame)
    counts &= result["in_contact"].values[frame][corners].sum(1) >= 2
    found = mesh.find_simplex(places)
    return float(np.nansum(each)), float(np.nansum(each[(found >= 0) & counts[found]]))
