"""Simulated presses of the skin chain at several frictions, for figures S5, S8 and S9 of Willemet et al. 2021.

The chain is a section through an axisymmetric finger: its strains are radial and hoop, and maps are rotated about
the axis. Strains are relative to the undeformed finger, those of a recording to each point's onset of contact.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from fingerflow.models.skin_chain import CONTACT_N, PressedChain, follow
from fingerflow.models.skin_parameters import PARAMETERS
from fingerflow.ops.fields.strain import green_lagrange, strain_energy_density
from fingerflow.plot.axes_style import finished, legend_below, line_styles
from fingerflow.plot.captions import describe

Values = NDArray[np.float64]
FRICTIONS = (0.02, 0.05, 0.2, 1.0)
LOW, HIGH = 0.2, 1.0  # friction coefficients that the paper calls low and high
DEPTH_MM = 2.0  # mm, depth over which the paper assumes uniform strain (equation 3)
_TIMES = 101
_ELEMENTS = 1001  # twice the paper's number: contact grows by whole elements, which is visible in rates
_SLOPE_S = 0.12  # s, interval of the line fit of a rate, in which contact grows by some elements
_MAP_CELLS = 241
_RADII = 201
_SINCE = "Strains count from the undeformed finger."


@dataclass(frozen=True)
class SimulatedPresses:
    """Simulations of a press with the skin-chain model at K friction coefficients and T times; `chain` holds arrays (T,
    K, ...) in SI units.
    """

    friction: tuple[float, ...]
    time: Values  # (T,) s, time
    force: Values  # (T,) N, normal force
    chain: PressedChain

    def index(self, friction: float) -> int:
        """Return the index of the simulation with a given friction coefficient."""
        return self.friction.index(friction)

    def profile(self) -> "Profile":
        """Return the radial and hoop (circumferential) strain of the skin against the radius from centre to edge of the
        contact, at each time and friction, interpolated between the chain's elements.
        """
        shape = (*self.chain.contact_length.shape, _RADII)
        radius = 5e2 * self.chain.contact_length.numpy()[..., None] * np.linspace(0, 1, _RADII)
        x = 1e3 * self.chain.position[..., 0].numpy()
        strain, divergence = self.chain.strain.numpy(), self.chain.divergence_field.numpy()
        radial, hoop = np.full(shape, np.nan), np.full(shape, np.nan)
        for place in np.argwhere(radius[..., -1] > 0):
            at = tuple(place)
            known = np.isfinite(strain[at])
            radial[at] = np.interp(radius[at], x[at][known], strain[at][known])
            hoop[at] = np.interp(radius[at], x[at][known], (divergence[at] - strain[at])[known])
        return Profile(radius, radial, hoop)

    def energy(self) -> Values:
        """Return the strain energy (T, K), mJ, of the skin over the contact disc down to a depth of 2 mm, by equation
        3, at T times and K frictions; 0 without contact.
        """
        found = self.profile()
        rings = np.nan_to_num(_density(found.radial, found.hoop)) * 2 * np.pi * found.radius
        return np.asarray(DEPTH_MM * np.trapezoid(rings, found.radius, axis=-1))


@dataclass(frozen=True)
class Profile:
    """Radial and hoop (circumferential) strain of the skin, (T, K, R) each, at T times, K frictions and R radii (mm)
    from the centre to the edge of the contact.
    """

    radius: Values
    radial: Values  # radial strain du/dx
    hoop: Values  # hoop strain u/x


def simulate_presses(
    friction: Sequence[float] = FRICTIONS, times: int = _TIMES, elements: int = _ELEMENTS
) -> SimulatedPresses:
    """Simulate a press with the skin-chain model at each friction coefficient, under a normal force that rises to 3 N
    in one second; `times` and `elements` are the numbers of time steps and chain elements.

    The contact of the skin chain has the area printed in the paper.
    """
    time = torch.linspace(0, 1.0, times, dtype=torch.float64)
    force = 3.0 * time
    skin = PARAMETERS["fitted"]
    chain = follow(torch.tensor(friction, dtype=torch.float64), time, force, parameters=skin, elements=elements)
    return SimulatedPresses(tuple(friction), time.numpy(), force.numpy(), chain)


def draw_strain_maps(part: SubFigure, presses: SimulatedPresses) -> NDArray[Any]:
    """Draw figures S8 B and D: maps of exx, eyy and exy (%) at full load, one row per friction, in equal colours."""
    extents, strains = _axisymmetric_maps(presses)
    largest = 100 * float(np.nanmax(np.abs(strains)))
    axes: NDArray[Any] = part.subplots(2, 3, sharex=True, sharey=True)
    scale = {"cmap": "RdBu_r", "vmin": -largest, "vmax": largest, "interpolation": "nearest"}
    for row, extent, strain, friction in zip(axes, extents, strains, (LOW, HIGH), strict=True):
        for one, values, name in zip(row, np.moveaxis(100 * strain, -1, 0), ("xx", "yy", "xy"), strict=True):
            image = one.imshow(values, extent=extent, **scale)
            one.set_title(rf"$\epsilon_{{{name}}}$, friction {friction:g}")
        row[0].set_ylabel("mm")
        row[0].locator_params(nbins=3)
    for one in axes[-1]:
        one.set_xlabel("mm")
    part.colorbar(image, ax=list(axes.flat), label="strain (%)", shrink=0.7)
    describe(
        axes.flat[0],
        "Green-Lagrange strains of the skin over the contact at full load, from the skin chain turned about its axis, "
        f"one row a friction coefficient. {_SINCE}",
    )
    return axes


def draw_energy_maps(part: SubFigure, presses: SimulatedPresses) -> Sequence[Axes]:
    """Draw figure S9 A: strain energy density (mJ/mm³) over the contact at full load, on one colour scale."""
    axes: Sequence[Axes] = part.subplots(1, 2, sharey=True)
    extents, strains = _axisymmetric_maps(presses)
    densities = strain_energy_density(torch.from_numpy(strains)).numpy()
    scale = {"cmap": "viridis", "vmin": 0, "vmax": np.nanmax(densities), "interpolation": "nearest"}
    for one, extent, density, friction in zip(axes, extents, densities, (LOW, HIGH), strict=True):
        image = one.imshow(density, extent=extent, **scale)
        one.set(title=f"friction {friction:g}", xlabel="mm")
    axes[0].set_ylabel("mm")
    part.colorbar(image, ax=list(axes), label="mJ/mm³", shrink=0.8)
    describe(
        axes[0],
        "Strain energy density over the contact at full load, from the skin chain turned about its axis, one map a "
        f"friction coefficient. {_SINCE}",
    )
    return axes


def draw_strain_series(part: SubFigure, presses: SimulatedPresses, rate: bool = False) -> Sequence[Axes]:
    """Draw figure S8 E: median radial and hoop strain (%) against normal force; with ``rate`` S8 F, their rates."""
    axes: Sequence[Axes] = part.subplots(1, 2, sharex=True)
    found = presses.profile()
    for one, strain, name in zip(axes, (found.radial, found.hoop), ("radial", "hoop"), strict=True):
        series = 100 * np.median(strain, axis=-1)
        if rate:
            series = _rate(series, presses.time)
        _draw_series(one, presses, series)
        if (own := one.get_legend()) is not None:
            own.remove()
        one.set(ylabel=f"median {name} strain{' rate (%/s)' if rate else ' (%)'}")
    legend_below(part, axes[0])
    derived = f", by line fits over {_SLOPE_S:g} s" if rate else ""
    describe(
        axes[0],
        f"Medians along the contact of the radial and hoop strain{' rate' * rate} of the skin chain{derived}, against "
        f"the normal force. {_SINCE} n = {len(presses.friction)} presses.",
    )
    return axes


def draw_energy_series(axes: Axes, presses: SimulatedPresses, rate: bool = False) -> Axes:
    """Draw figure S9 B: total strain energy (mJ) against normal force; with ``rate`` figure S9 C, its rate (mJ/s)."""
    energy = presses.energy()
    _draw_series(axes, presses, _rate(energy, presses.time) if rate else energy)
    axes.set(ylabel="strain energy rate (mJ/s)" if rate else "total strain energy (mJ)")
    derived = f" rate, by line fits over {_SLOPE_S:g} s," if rate else ""
    describe(
        axes,
        f"Strain energy{derived} of the skin in contact to a depth of {DEPTH_MM:g} mm, of the skin chain, against the "
        f"normal force. {_SINCE} n = {len(presses.friction)} presses.",
    )
    return axes


def draw_fastest_point(axes: Axes, presses: SimulatedPresses) -> Axes:
    """Draw figure S5 K for the skin-chain model: the tangential speed (mm/s) of the element in contact that is
    displaced furthest by the end, against normal force.
    """
    moved = 1e3 * presses.chain.displacement[..., 0].numpy()
    touching = presses.chain.normal_force.numpy()[-1] > CONTACT_N
    furthest = np.where(touching, np.abs(moved[-1]), -1.0).argmax(-1)
    own = np.take_along_axis(moved, furthest[None, :, None], axis=-1)[..., 0]
    _draw_series(axes, presses, np.abs(_rate(own, presses.time)))
    axes.set(ylabel="speed of the furthest point (mm/s)")
    describe(
        axes,
        "Speed along the plate of the element of the skin chain that is displaced furthest in contact, by line fits "
        f"over {_SLOPE_S:g} s, against the normal force. n = {len(presses.friction)} presses.",
    )
    return axes


def draw_largest_displacement(axes: Axes, presses: SimulatedPresses) -> Axes:
    """Draw figure S5 J for the skin-chain model: the largest tangential displacement (mm) of skin in contact at full
    load, one bar per friction coefficient.
    """
    moved = 1e3 * presses.chain.displacement[-1, ..., 0].numpy()
    largest = np.where(presses.chain.normal_force.numpy()[-1] > CONTACT_N, np.abs(moved), 0).max(-1)
    names = [f"{friction:g}" for friction in presses.friction]
    axes.bar(names, largest, 0.6, color=[style["color"] for style in line_styles(len(names), ordered=True)])
    axes.set(xlabel="friction coefficient", ylabel="largest displacement (mm)")
    return finished(
        axes,
        "Largest displacement along the plate in contact at full load, of the skin chain, by friction coefficient. "
        f"n = {len(presses.friction)} presses.",
    )


def _draw_series(axes: Axes, presses: SimulatedPresses, series: Values) -> None:
    styles = line_styles(len(presses.friction), ordered=True)
    for values, friction, style in zip(series.T, presses.friction, styles, strict=True):
        axes.plot(presses.force, values, label=f"friction {friction:g}", **style)
    axes.set(xlabel="normal force (N)")
    finished(axes)


def _rate(series: Values, time: Values) -> Values:
    """Return the time derivatives (T, K), per second, of K series at T equal time steps: slopes of lines fitted to 0.12
    s of values, NaN near the ends.
    """
    step = float(time[1] - time[0])
    width = max(1, round(_SLOPE_S / step / 2))
    rates = savgol_filter(series, 2 * width + 1, polyorder=1, deriv=1, delta=step, axis=0, mode="constant")
    rates[:width] = rates[-width:] = np.nan
    return np.asarray(rates)


def _density(radial: Values, hoop: Values) -> Values:
    gradient = torch.zeros(*radial.shape, 2, 2, dtype=torch.float64)
    gradient[..., 0, 0], gradient[..., 1, 1] = torch.from_numpy(radial), torch.from_numpy(hoop)
    return np.asarray(strain_energy_density(green_lagrange(gradient)))


def _axisymmetric_maps(presses: SimulatedPresses) -> tuple[list[tuple[float, float, float, float]], Values]:
    """Return the extents (mm) of the contact and maps (2, H, W, 3) of the strains exx, eyy and exy over it, at low and
    high friction, from the radial strains of the chain by axial symmetry.

    They are those at full load; NaN off contact.
    """
    found = presses.profile()
    extents, gradients = [], []
    for k in (presses.index(LOW), presses.index(HIGH)):
        radius = found.radius[-1, k]
        reach = float(radius[-1])
        x, y = np.meshgrid(*2 * [np.linspace(-reach, reach, _MAP_CELLS)])
        distance = np.hypot(x, y)
        radial, hoop = (np.interp(distance, radius, one[-1, k], right=np.nan) for one in (found.radial, found.hoop))
        outward = np.stack([np.divide(one, distance, out=np.ones_like(one), where=distance > 0) for one in (x, y)], -1)
        along = outward[..., :, None] * outward[..., None, :]
        gradients.append(radial[..., None, None] * along + hoop[..., None, None] * (np.eye(2) - along))
        extents.append((-reach, reach, reach, -reach))
    return extents, green_lagrange(torch.from_numpy(np.stack(gradients))).numpy()
