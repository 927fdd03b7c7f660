"""True displacement field of the simulated press of `fingerflow demo`, for figures S6 and S13."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from numpy.typing import NDArray

from fingerflow.plot.axes_style import INK, finished
from fingerflow.schema.variables import VARIABLES
from fingerflow.synthetic import SyntheticScene

_CURL, _MEDIAN_CURL = VARIABLES["curl"], VARIABLES["median_curl"]
Values = NDArray[np.float64]
_SPACING_MM = 0.6  # mm, distance between grid points
_FRAMES = 24  # number of frames with a median curl


@dataclass(frozen=True)
class PressField:
    """True displacement and curl of the skin in a synthetic press, at P points of the contact in the last frame, and
    the median curl over the contact in each of F frames.
    """

    reference: Values  # (P, 2) mm, reference positions
    displacement: Values  # (P, 2) mm, displacement since onset of contact
    curl: Values  # (P,) rad, curl of the displacement
    force: Values  # (F,) N, normal force
    median_curl: Values  # (F,) rad, median curl over the gross contact area


def press_field(scene: SyntheticScene) -> PressField:
    """Return the ground-truth field of a synthetic press; the finger must be in contact in the last frame."""
    truth, last = scene.truth, len(scene.times) - 1
    ellipse = truth.ellipse(last)
    assert ellipse is not None
    reach = max(ellipse.semi_axes)
    steps = np.arange(-np.ceil(reach / _SPACING_MM), np.ceil(reach / _SPACING_MM) + 1) * _SPACING_MM
    grid = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2) + ellipse.centre
    material = truth.material(grid, last)
    displacement = truth.displacement(material, last)
    inside = np.isfinite(displacement).all(1)
    position, displacement, material = grid[inside], displacement[inside], material[inside]
    gradient = truth.gradient(material, last)
    frames = np.unique(np.linspace(0, last, _FRAMES).round().astype(int)).tolist()
    found = [truth.medians(frame).curl if truth.ellipse(frame) is not None else np.nan for frame in frames]
    return PressField(
        reference=position - displacement,
        displacement=displacement,
        curl=gradient[:, 1, 0] - gradient[:, 0, 1],
        force=np.asarray(scene.normal_force(scene.times))[frames],
        median_curl=np.array(found),
    )


def draw_curl_map(part: SubFigure, field: PressField) -> Axes:
    """Draw figure S13 A: the curl at each point of the contact."""
    axes: Axes = part.subplots()
    values = _CURL.shown_values(field.curl)
    largest = float(np.nanmax(np.abs(values)))
    x, y = field.reference.T
    dots = axes.scatter(x, y, s=12, c=values, cmap="RdBu_r", vmin=-largest, vmax=largest, marker="s")
    axes.set(xlabel="mm", ylabel="mm", aspect="equal", title="simulated press")
    part.colorbar(dots, ax=axes, label=_CURL.axis_label, shrink=0.75)
    finished(
        axes,
        f"True curl at the largest force of a simulated press: {_CURL.long_name}. n = {len(values)} points.",
    )
    axes.invert_yaxis()
    return axes


def draw_median_curl(axes: Axes, field: PressField) -> Axes:
    """Draw figure S13 B: median curl over the contact against the normal force."""
    axes.plot(field.force, _MEDIAN_CURL.shown_values(field.median_curl), color=INK)
    axes.set(xlabel="normal force (N)", ylabel=_MEDIAN_CURL.axis_label)
    return finished(axes, f"True {_MEDIAN_CURL.long_name} during a simulated press. n = {len(field.force)} frames.")
