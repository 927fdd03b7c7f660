"""Simulated presses of the skin chain at several frictions, and panels J and K of figure S5 of Willemet et al. 2021.

The chain is a section through an axisymmetric finger: its strains are radial and hoop. They count from the first frame
with contact force, from onset in the contact dilated by 8 px, or from each point's own onset.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from fingerflow.models.skin_chain import CONTACT_N, PressedChain, follow, weighted_median
from fingerflow.models.skin_onset import FIRST_FRAME_M, SinceOnset, since_onset
from fingerflow.models.skin_parameters import PARAMETERS
from fingerflow.ops.fields.strain import green_lagrange, strain_energy_density
from fingerflow.plot.axes_style import finished, line_styles

Values = NDArray[np.float64]
FRICTIONS = (0.0, 0.05, 0.2, 1.0)
LOW, HIGH = 0.2, 1.0  # friction coefficients that the paper calls low and high
DEPTH_MM = 2.0  # mm, depth over which the paper assumes uniform strain (equation 3)
_ELEMENTS = 1001  # twice the paper's number: contact grows by whole elements, which is visible in rates
_SLOPE_S = 0.12  # s, interval of the line fit of a rate, in which contact grows by some elements
_DILATED_M = 8 * 32.5e-6  # m, the printed dilation of the contact, 8 px


@dataclass(frozen=True)
class SimulatedPresses:
    """Simulations of a press with the skin-chain model at K friction coefficients and T times; `chain` holds arrays (T,
    K, ...) in SI units.
    """

    friction: tuple[float, ...]
    time: Values  # (T,) s, time
    force: Values  # (T,) N, normal force
    chain: PressedChain

    def gains(self, values: Values) -> dict[float, float]:
        """Return the ratios of a quantity (K,), one value per friction, at high friction to that at each other one."""
        high = values[self.friction.index(HIGH)]
        return {friction: float(high / values[k]) for k, friction in enumerate(self.friction) if friction != HIGH}

    @cached_property
    def printed(self) -> SinceOnset:
        """Return the skin since the first frame with contact force, from which the lab's script counts strain."""
        return since_onset(self.chain, FIRST_FRAME_M)

    @cached_property
    def dilated(self) -> SinceOnset:
        """Return the skin since onset in the dilated contact, from which the lab's script counts divergence."""
        return since_onset(self.chain, _DILATED_M)

    @cached_property
    def own(self) -> SinceOnset:
        """Return the skin since each point's own onset, from which this engine counts by default."""
        return since_onset(self.chain)

    def rate(self, series: Values) -> Values:
        """Return the time derivatives (T, K), per second, of series (T, K): slopes of lines fitted to 0.12 s of values,
        NaN near the ends.
        """
        step = float(self.time[1] - self.time[0])
        width = max(1, round(_SLOPE_S / step / 2))
        rates = savgol_filter(series, 2 * width + 1, polyorder=1, deriv=1, delta=step, axis=0, mode="constant")
        rates[:width] = rates[-width:] = np.nan
        return np.asarray(rates)


def strain_percent(skin: SinceOnset) -> Values:
    """Return the Green-Lagrange strain (T, K) along an axis, %: the median over the contact of the mean over all
    directions.
    """
    slopes = torch.stack((skin.radial, skin.hoop))
    mean = (slopes + slopes.square() / 2).mean(0).nan_to_num(0.0)
    return 100 * np.nan_to_num(weighted_median(mean, skin.ring_area).numpy())


def script_curl(skin: SinceOnset) -> Values:
    """Return the median (T, K) over the contact of u_x - u_y, which the lab's script calls curl: it takes the x
    displacement twice.
    """
    # With e_r and e_h along and around the radius, u_x - u_y at an angle t is
    # (e_r + e_h) / 2 + (e_r - e_h) (cos 2t - sin 2t) / 2, here at 36 angles of the half turn after which it recurs.
    twice = torch.arange(36, dtype=torch.float64) * (torch.pi / 18)
    even, shear = ((skin.radial + sign * skin.hoop).nan_to_num(0.0)[..., None] / 2 for sign in (1, -1))
    values = (even + shear * (twice.cos() - twice.sin())).flatten(-2)
    return np.nan_to_num(weighted_median(values, skin.ring_area.repeat_interleave(len(twice), -1)).numpy())


def energy_mj(skin: SinceOnset) -> Values:
    """Return the strain energy (T, K), mJ, of the skin over the contact down to a depth of 2 mm, by equation 3."""
    gradient = torch.diag_embed(torch.stack((skin.radial, skin.hoop), -1).nan_to_num(0.0))
    density = strain_energy_density(green_lagrange(gradient))
    return np.asarray(DEPTH_MM * (density * 1e6 * skin.ring_area).sum(-1))


def simulate_presses(
    friction: Sequence[float] = FRICTIONS, times: int = 101, elements: int = _ELEMENTS
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


def draw_fastest_point(axes: Axes, presses: SimulatedPresses) -> Axes:
    """Draw figure S5 K for the skin-chain model: the tangential speed (mm/s) of the element in contact that is
    displaced furthest by the end, against normal force.
    """
    moved = 1e3 * presses.chain.displacement[..., 0].numpy()
    furthest = np.where(presses.chain.normal_force[-1] > CONTACT_N, np.abs(moved[-1]), -1.0).argmax(-1)
    own = np.take_along_axis(moved, furthest[None, :, None], axis=-1)[..., 0]
    styles = line_styles(len(presses.friction), ordered=True)
    for values, friction, style in zip(np.abs(presses.rate(own)).T, presses.friction, styles, strict=True):
        axes.plot(presses.force, values, label=f"friction {friction:g}", **style)
    axes.set(xlabel="normal force (N)", ylabel="speed of the furthest point (mm/s)", ylim=(0, None))
    axes.set_ylim(top=1.5 * axes.get_ylim()[1])  # leaves space for the legend
    return finished(
        axes,
        "Speed along the plate of the element of the skin chain that is displaced furthest in contact, by line fits "
        f"over {_SLOPE_S:g} s, against the normal force. n = {len(presses.friction)} presses.",
    )


def draw_largest_displacement(axes: Axes, presses: SimulatedPresses) -> Axes:
    """Draw figure S5 J for the skin-chain model: the largest tangential displacement (mm) of skin in contact at full
    load, one bar per friction coefficient.
    """
    moved = 1e3 * presses.chain.displacement[-1, ..., 0].numpy()
    largest = np.where(presses.chain.normal_force[-1] > CONTACT_N, np.abs(moved), 0).max(-1)
    names = [f"{friction:g}" for friction in presses.friction]
    axes.bar(names, largest, 0.6, color=[style["color"] for style in line_styles(len(names), ordered=True)])
    axes.set(xlabel="friction coefficient", ylabel="largest displacement (mm)")
    return finished(
        axes,
        "Largest displacement along the plate in contact at full load, of the skin chain, by friction coefficient. "
        f"n = {len(presses.friction)} presses.",
    )
