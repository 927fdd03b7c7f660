"""Figure S4 of Willemet et al. 2021: geometry and compression of a half-sphere of skin pressed flat."""

import numpy as np
import torch
from matplotlib.axes import Axes

from fingerflow.models.hemisphere import arc_length, contact_radius, radial_strain
from fingerflow.plot.axes_style import GREY, INK, RED, finished

RADIUS_MM = 10.0  # mm, follows from the printed "10 %" at 3 mm
DEPTH_MM, DEEPEST_MM = 3.0, 4.0


def draw_half_sphere(axes: Axes) -> Axes:
    """Draw figure S4 A: a fingertip, as a half-sphere, pressed 3 mm into the glass, with the arc (2 L) of skin that is
    pressed flat and the width (2 a) of the contact, mm.
    """
    delta, radius = DEPTH_MM, RADIUS_MM
    turn = np.linspace(0, np.pi, 181)
    axes.plot(radius * np.cos(turn), radius - delta - radius * np.sin(turn), color=GREY)
    axes.axhline(0, color=INK)
    angle = float(arc_length(delta, radius)) / radius
    arc = np.linspace(-angle, angle, 91)
    name = f"2 L = {2 * radius * angle:.1f} mm"
    axes.plot(radius * np.sin(arc), radius - delta - radius * np.cos(arc), color=RED, linewidth=2, label=name)
    half = float(contact_radius(delta, radius))
    axes.plot([-half, half], [0, 0], color=INK, linewidth=2, linestyle="--", label=f"2 a = {2 * half:.1f} mm")
    axes.annotate("", (0, -delta), (0, 0), arrowprops={"arrowstyle": "<->", "color": INK, "shrinkA": 0, "shrinkB": 0})
    axes.annotate(f"δ = {delta:g} mm", (0, 0.8), ha="center")
    axes.set(xlabel="mm", ylabel="above the glass (mm)", aspect="equal", ylim=(-1.2 * delta, 1.05 * radius))
    finished(
        axes,
        f"Half-sphere of radius {radius:g} mm pressed {delta:g} mm into the glass: its arc 2 L, which becomes the "
        "contact 2 a where the skin sticks.",
    )
    axes.legend(frameon=False, loc="upper center")
    return axes


def draw_lengths(axes: Axes) -> Axes:
    """Draw figure S4 B: half the arc of skin that is pressed flat (L) and the radius of the contact (a), mm, against
    the normal indentation (mm).
    """
    delta = torch.linspace(0, DEEPEST_MM, 201, dtype=torch.float64)
    axes.plot(delta, arc_length(delta, RADIUS_MM), color=RED, linestyle="--", label="L, arc of the skin")
    axes.plot(delta, contact_radius(delta, RADIUS_MM), color=INK, label="a, contact")
    axes.set(xlabel="normal indentation δ (mm)", ylabel="length (mm)", title=f"R = {RADIUS_MM:g} mm")
    return finished(
        axes, f"Arc length L and contact radius a against the indentation δ, for a radius R of {RADIUS_MM:g} mm."
    )


def draw_radial_strain(axes: Axes) -> Axes:
    """Draw figure S4 C: the compression (L - a) / L (%) of skin that sticks to the glass, as its arc L is pressed into
    the contact radius a, against the indentation (mm), with 3 mm marked.
    """
    delta = torch.linspace(0, DEEPEST_MM, 201, dtype=torch.float64)
    axes.plot(delta, 100 * radial_strain(delta, RADIUS_MM), color=INK)
    at_three = 100 * float(radial_strain(DEPTH_MM, RADIUS_MM))
    axes.plot(DEPTH_MM, at_three, "o", color=RED, label=f"{at_three:.1f} % at 3 mm")
    axes.set(xlabel="normal indentation δ (mm)", ylabel="(L - a) / L (%)")
    return finished(axes, "Compression (L - a) / L of sticking skin against the indentation δ.")
