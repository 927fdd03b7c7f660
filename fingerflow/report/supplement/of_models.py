"""Figures S4, S6 and S10 of the supplement, computed from simulations without measured data."""

from fingerflow.report.decomposition import decompose, draw_decomposition
from fingerflow.report.half_sphere import draw_half_sphere, draw_lengths, draw_radial_strain
from fingerflow.report.strains_at_depth import (
    draw_compression,
    draw_evolution,
    draw_receptor_stress,
    draw_strain_in_time,
    draw_stress_map,
    draw_surface,
)
from fingerflow.report.supplement.sheet import Sheet, SheetPanel
from fingerflow.report.supplement.sources import Sources

_STACKED = 1.6  # height of a panel with several axes relative to one with a single axis


def half_sphere(_: Sources) -> Sheet:
    """Return figure S4: a half-sphere of skin pressed flat."""
    return Sheet(
        "S4",
        (
            SheetPanel.of_axes("A", draw_half_sphere),
            SheetPanel.of_axes("B", draw_lengths),
            SheetPanel.of_axes("C", draw_radial_strain),
        ),
        title="half-sphere of skin pressed flat",
    )


def decomposition(sources: Sources) -> Sheet:
    """Return figure S6: decomposition of the displacement field of the simulated press."""
    found = decompose(sources.field.reference, sources.field.displacement)
    panel = SheetPanel("", lambda part: draw_decomposition(part, found), columns=3, rows=1.8, narrow_rows=2.8)
    return Sheet("S6", (panel,), title="decomposition of the displacement field of a simulated press")


def strains_at_depth(sources: Sources) -> Sheet:
    """Return figure S10: stress and strain at receptor depth."""
    presses, depth = sources.presses, sources.depth
    return Sheet(
        "S10",
        (
            SheetPanel("A", lambda part: draw_evolution(part, presses), rows=_STACKED),
            SheetPanel("B", lambda part: draw_surface(part, presses), rows=_STACKED),
            SheetPanel("C", lambda part: draw_stress_map(part, presses, depth), rows=_STACKED),
            SheetPanel("D", lambda part: draw_receptor_stress(part, presses, depth), rows=_STACKED),
            SheetPanel("E", lambda part: draw_strain_in_time(part, presses, depth)),
            SheetPanel.of_axes("F", draw_compression, presses, depth),
        ),
        title="stress and strain under the skin of the simulated presses",
    )
