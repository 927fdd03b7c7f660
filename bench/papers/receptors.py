"""Figure S10 of Willemet et al. 2021: stresses and strains at receptor depth during a press of the skin chain."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from numpy.typing import NDArray

from bench.papers.chain import HIGH, LOW, SimulatedPresses
from fingerflow.models.half_space import stress
from fingerflow.models.viscoelastic import RECEPTOR_DEPTHS_M, viscoelastic_strain
from fingerflow.plot.axes_style import GREY, finished, line_styles
from fingerflow.plot.captions import describe

Values = NDArray[np.float64]
_REACH_MM = 5.0  # mm, shown range along the surface on either side of the middle of the contact
_APART_MM = 1.2  # mm, spacing of marked receptors
_ALONG = "along the plate (mm)"
_SHAPES = 6  # number of drawn shapes of the skin during a press


@dataclass(frozen=True)
class Depth:
    """Stress at full load and strain over time below the skin surface in K simulated presses, at Y positions along the
    surface; stress also as a map over Z depths.
    """

    place: Values  # (Y,) mm, position along the surface
    map_depth: Values  # (Z,) mm, depth
    sigma_z: Values  # (K, Z, Y) kPa at full load, tension positive
    receptor_stress: Values  # (3, K, Y) kPa at full load 2 mm deep: sigma_y, sigma_z, tau_yz
    strain_y: Values  # (T, K, Y) without unit, 2 mm deep, along the surface, extension positive
    strain_z: Values  # (T, K, Y) without unit, 2 mm deep, along the depth


def compute_strains_at_depth(presses: SimulatedPresses, places: int = 101, depths: int = 40) -> Depth:
    """Compute the stress below the surface of simulated presses at `places` positions along it and `depths` depths, and
    the viscoelastic strain 2 mm deep that it causes.
    """
    edges, pressure, traction = presses.chain.strips()
    y = torch.linspace(-_REACH_MM, _REACH_MM, places, dtype=torch.float64)
    z = torch.linspace(0.05, 5.0, depths, dtype=torch.float64)
    receptor = RECEPTOR_DEPTHS_M[-1]
    _, sigma_z, _ = stress(1e-3 * y, 1e-3 * z[:, None], edges[-1], pressure[-1], traction[-1])
    series = stress(1e-3 * y, receptor, edges, pressure, traction)
    strain_y, strain_z = viscoelastic_strain(*series[:2], torch.from_numpy(presses.time))
    return Depth(
        place=y.numpy(),
        map_depth=z.numpy(),
        sigma_z=1e-3 * sigma_z.numpy(),
        receptor_stress=1e-3 * torch.stack(series)[:, -1].numpy(),
        strain_y=strain_y.numpy(),
        strain_z=strain_z.numpy(),
    )


def draw_evolution(part: SubFigure, presses: SimulatedPresses) -> None:
    """Draw figure S10 A: contact pressure (kPa) and shape of the skin (mm) as the force rises, at high friction."""
    above, below = part.subplots(2, 1, sharex=True)
    k = presses.friction.index(HIGH)
    frames = np.linspace(0, len(presses.time) - 1, _SHAPES).round().astype(int)
    for frame, style in zip(frames, reversed(line_styles(_SHAPES, ordered=True)), strict=True):
        x, z = 1e3 * presses.chain.position[frame, k].T.numpy()
        name = f"{presses.force[frame]:.1f} N"
        above.plot(x, 1e-3 * presses.chain.pressure[frame, k].numpy(), label=name, **style)
        below.plot(x, z, **style)
    below.axhline(0, color=GREY, linewidth=0.8)
    above.set(ylabel="pressure (kPa)", title=f"friction {HIGH:g}")
    below.set(xlabel=_ALONG, ylabel="skin (mm)", xlim=(-_REACH_MM, _REACH_MM), ylim=(-0.15, 1.8))
    caption = f"Pressure on the skin and its shape at n = {_SHAPES} forces of one press of the skin chain, friction "
    _finish(part, (above, below), f"{caption}coefficient {HIGH:g}.")


def draw_surface(part: SubFigure, presses: SimulatedPresses) -> None:
    """Draw figure S10 B: pressure and traction (kPa) on the skin at full load, one line per friction."""
    axes: Sequence[Axes] = part.subplots(2, 1, sharex=True)
    for k, style in enumerate(_line_styles(presses)):
        x = 1e3 * presses.chain.position[-1, k, :, 0].numpy()
        for one, load in zip(axes, (presses.chain.pressure, presses.chain.traction), strict=True):
            one.plot(x, 1e-3 * load[-1, k].numpy(), **style)
    axes[0].set(ylabel="pressure (kPa)", title=f"{presses.force[-1]:.1f} N")
    axes[1].set(xlabel=_ALONG, ylabel="traction (kPa)", xlim=(-_REACH_MM, _REACH_MM))
    _finish(part, axes, f"Pressure and traction on the skin at {presses.force[-1]:.1f} N. {_count(presses)}")


def draw_stress_map(part: SubFigure, presses: SimulatedPresses, depth: Depth) -> None:
    """Draw figure S10 C: normal stress (kPa) inside the skin at full load, with receptors as black dots."""
    axes: Sequence[Axes] = part.subplots(2, 1, sharex=True)
    lowest = float(depth.sigma_z.min())
    for one, friction in zip(axes, (min(presses.friction), HIGH), strict=True):
        values = depth.sigma_z[presses.friction.index(friction)]
        image = one.pcolormesh(depth.place, depth.map_depth, values, cmap="YlOrRd_r", vmin=lowest, vmax=0)
        for down in RECEPTOR_DEPTHS_M:
            along = np.arange(-3, 4) * _APART_MM
            one.plot(along, np.full(along.shape, 1e3 * down), "k.", markersize=4)
        one.set(ylabel="depth (mm)", title=f"friction {friction:g}", ylim=(depth.map_depth[-1], 0))
    axes[1].set_xlabel(_ALONG)
    part.colorbar(image, ax=list(axes), label=r"$\sigma_z$ (kPa)")
    describe(
        axes[0],
        f"Normal stress σz inside the skin at {presses.force[-1]:.1f} N, tension positive, at a low and a high "
        "friction coefficient. Dots: depths of receptors.",
    )


def draw_receptor_stress(part: SubFigure, presses: SimulatedPresses, depth: Depth) -> None:
    """Draw figure S10 D: the three stress components (kPa) 2 mm deep at full load, one line per friction."""
    axes: Sequence[Axes] = part.subplots(3, 1, sharex=True)
    names = (r"$\sigma_y$ (kPa)", r"$\sigma_z$ (kPa)", r"$\tau_{yz}$ (kPa)")
    for one, values, name in zip(axes, depth.receptor_stress, names, strict=True):
        for profile, style in zip(values, _line_styles(presses), strict=True):
            one.plot(depth.place, profile, **style)
        one.set_ylabel(name)
    peak = depth.receptor_stress[1].min(-1)
    axes[0].set_title(f"peak of $\\sigma_z$, {_ratio(presses, peak)}, in print 1.2")
    axes[2].set_xlabel(f"{_ALONG}, 2 mm deep")
    stresses = f"Stresses 2 mm deep at {presses.force[-1]:.1f} N: along the surface σy, normal σz and shear τyz."
    _finish(part, axes, f"{stresses} {_count(presses)}")


def draw_strain_in_time(part: SubFigure, presses: SimulatedPresses, depth: Depth) -> None:
    """Draw figure S10 E: tangential strain (%) 2 mm deep as a map over position and time, at high friction."""
    axes = part.subplots()
    strain = 100 * depth.strain_y[:, presses.friction.index(HIGH)]
    largest = float(np.abs(strain).max())
    image = axes.pcolormesh(depth.place, presses.time, strain, cmap="RdBu_r", vmin=-largest, vmax=largest)
    axes.set(xlabel=f"{_ALONG}, 2 mm deep", ylabel="time (s)", title=f"friction {HIGH:g}")
    part.colorbar(image, ax=axes, label=r"$\epsilon_y$ (%), extension positive")
    describe(axes, f"Viscoelastic strain along the surface 2 mm deep, in one press at friction coefficient {HIGH:g}.")


def draw_compression(axes: Axes, presses: SimulatedPresses, depth: Depth) -> None:
    """Draw figure S10 F: compression (%) of the tissue 2 mm below the middle of the contact against time."""
    compression = -100 * depth.strain_z[:, :, len(depth.place) // 2]
    for series, style in zip(compression.T, _line_styles(presses), strict=True):
        axes.plot(presses.time, series, **style)
    axes.set(xlabel="time (s)", ylabel=r"compression $-\epsilon_z$ (%)")
    axes.set_title(f"{_ratio(presses, compression[-1])}, in print almost 1.2")
    finished(axes, f"Compression 2 mm under the middle against time; ratios at the end. {_count(presses)}")


def _finish(part: SubFigure, axes: Sequence[Axes], caption: str) -> None:
    for one in axes:
        one.grid(alpha=0.25)
    handles, labels = axes[0].get_legend_handles_labels()
    part.legend(handles, labels, frameon=False, ncols=2 + len(labels) // 5, loc="outside lower center")
    describe(axes[0], caption)


def _count(presses: SimulatedPresses) -> str:
    return f"n = {len(presses.friction)} presses of the skin chain."


def _line_styles(presses: SimulatedPresses) -> list[dict[str, Any]]:
    """Return keyword arguments of `Axes.plot` for one line per simulated friction, each thinner than the one before so
    that overlapping curves stay visible.
    """
    widths = np.linspace(2.6, 0.8, len(presses.friction))
    styles = line_styles(len(presses.friction), ordered=True)
    return [
        {**style, "linewidth": width, "label": f"friction {friction:g}"}
        for friction, style, width in zip(presses.friction, styles, widths, strict=True)
    ]


def _ratio(presses: SimulatedPresses, values: Values) -> str:
    """Return text with the ratios of a quantity (K,), one value per simulated friction, at high friction to that at low
    and at the lowest friction.
    """
    gains = presses.gains(values)
    return f"friction {HIGH:g} " + ", ".join(f"over {one:g}: {gains[one]:.3f}" for one in (LOW, min(gains)))
