"""Figures S4, S6 and S10: simulation alone."""

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
from fingerflow.report.supplement.sheet import Panel, Sheet
from fingerflow.report.supplement.sources import Sources


def half_sphere(_: Sources) -> Sheet:
    """Figure S4."""
    return Sheet(
        "S4",
        (
            Panel("A", lambda part: draw_half_sphere(part.subplots())),
            Panel("B", lambda part: draw_lengths(part.subplots())),
            Panel("C", lambda part: draw_radial_strain(part.subplots())),
        ),
    )


def decomposition(sources: Sources) -> Sheet:
    """Figure S6, of the simulated press."""
    found = decompose(sources.field.reference, sources.field.displacement)

    return Sheet("S6", (Panel("", lambda part: draw_decomposition(part, found), columns=3, rows=1.8),))


def strains_at_depth(sources: Sources) -> Sheet:
    """Figure S10."""
    presses, depth = sources.presses, sources.depth
    return Sheet(
        "S10",
        (
            Panel("A", lambda part: draw_evolution(part, presses)),
            Panel("B", lambda part: draw_surface(part, presses)),
            Panel("C", lambda part: draw_stress_map(part, presses, depth)),
            Panel("D", lambda part: draw_receptor_stress(part, presses, depth)),
            Panel("E", lambda part: draw_strain_in_time(part, presses, depth)),
            Panel("F", lambda part: draw_compression(part.subplots(), presses, depth)),
        ),
    )
