"""Figures S1, S5, S7, S8 and S9 of the supplement: from a tribometer trace, a table of trials, or the skin chain."""

from functools import partial
from typing import Any

from fingerflow.report.simulated_presses import (
    draw_energy_maps,
    draw_energy_series,
    draw_fastest_point,
    draw_largest_displacement,
    draw_strain_maps,
    draw_strain_series,
)
from fingerflow.report.supplement.sheet import Sheet, SheetPanel
from fingerflow.report.supplement.sources import Sources
from fingerflow.report.trial_metrics import (
    draw_by_condition,
    draw_correlation,
    draw_distribution,
    draw_influence,
    draw_influence_by_condition,
    draw_share_against,
)
from fingerflow.report.tribometer import draw_friction, draw_trace

_RECORDING = "pictures and series of recordings, which no table of trials holds"
_NO_TRACE = "a tribometer trace (--tribometer)"

_BY_CONDITION_NORMALISED = partial(draw_by_condition, normalised=True)


def friction_and_area(sources: Sources) -> Sheet:
    """Return figure S1: friction from the tribometer trace, contact areas from the table of trials."""
    panels: list[SheetPanel] = []
    left_out: list[tuple[str, str]] = []
    trace, epochs = sources.tribometer, sources.epochs
    if trace is None or epochs is None:
        left_out += [(letter, _NO_TRACE) for letter in "AB"]
    else:
        panels = [
            SheetPanel("A", lambda part: draw_trace(part.subplots(4, 1, sharex=True), trace, epochs), 2, 1.4),
            SheetPanel.of_axes("B", draw_friction, epochs),
        ]
    left_out += [(letter, _RECORDING) for letter in "CE"]
    found, lacking = _from_table(
        sources,
        ("D", _BY_CONDITION_NORMALISED, "gross_contact_area"),
        ("F", _BY_CONDITION_NORMALISED, "real_contact_area"),
    )
    return Sheet("S1", (*panels, *found), Sheet.missing_sentences(left_out + lacking), "friction and contact area")


def kinematics(sources: Sources) -> Sheet:
    """Return figure S5: force and motion, from the table of trials; J and K also from the skin chain."""
    found, lacking = _from_table(
        sources,
        ("B", draw_distribution, "max_force"),
        ("C", draw_distribution, "time_to_max_force"),
        ("D", draw_distribution, "duration"),
        ("E", draw_influence, "max_force"),
        ("F", draw_influence, "time_to_max_force"),
        ("G", draw_influence, "duration"),
        ("H", draw_distribution, "force_rate"),
        ("I", draw_influence_by_condition, "force_rate"),
        ("J", draw_by_condition, "max_displacement"),
    )
    chain = (
        SheetPanel("J (skin chain)", lambda part: draw_largest_displacement(part.subplots(), sources.presses)),
        SheetPanel("K (skin chain)", lambda part: draw_fastest_point(part.subplots(), sources.presses)),
    )
    left_out = Sheet.missing_sentences([("A", _RECORDING), *lacking])
    return Sheet("S5", (*found, *chain), left_out, "force and motion of the trials")


def displacement_and_angle(sources: Sources) -> Sheet:
    """Return figure S7: displacement and force angle; D and E compare with the reference surface where known."""
    found, lacking = _from_table(
        sources,
        ("A", draw_by_condition, "global_displacement"),
        ("B", draw_by_condition, "force_angle"),
        ("C", draw_share_against, "global_displacement"),
        ("D", draw_share_against, sources.difference_column("force_angle")),
        ("E", draw_share_against, sources.difference_column("real_contact_area")),
    )
    return Sheet("S7", tuple(found), Sheet.missing_sentences(lacking), "displacement and force angle")


def surface_strain(sources: Sources) -> Sheet:
    """Return figure S8: surface strain; panels B, D, E and F from the skin chain, others from the table of trials."""
    chain = (
        SheetPanel(
            "B and D (skin chain)",
            lambda part: draw_strain_maps(part, sources.presses),
            columns=3,
            rows=2,
            narrow_rows=1.6,
        ),
        SheetPanel("E (skin chain)", lambda part: draw_strain_series(part, sources.presses), columns=3),
        SheetPanel("F (skin chain)", lambda part: draw_strain_series(part, sources.presses, rate=True), columns=3),
    )
    found, lacking = _from_table(
        sources,
        ("G", draw_correlation, "divergence", "strain"),
        ("H", draw_share_against, sources.difference_column("strain")),
        ("I", draw_share_against, "strain_rate"),
    )
    left_out = Sheet.missing_sentences([("A", _RECORDING), ("C", _RECORDING), *lacking])
    return Sheet("S8", (*chain, *found), left_out, "strain of the surface")


def strain_energy(sources: Sources) -> Sheet:
    """Return figure S9: strain energy; panels A, B and C from the skin chain, others from the table of trials."""
    chain = (
        SheetPanel("A (skin chain)", lambda part: draw_energy_maps(part, sources.presses), columns=2),
        SheetPanel("B (skin chain)", lambda part: draw_energy_series(part.subplots(), sources.presses)),
        SheetPanel("C (skin chain)", lambda part: draw_energy_series(part.subplots(), sources.presses, rate=True)),
    )
    found, lacking = _from_table(
        sources,
        ("D", draw_correlation, "divergence", "strain_energy"),
        ("E", draw_share_against, sources.difference_column("strain_energy")),
    )
    return Sheet("S9", (*chain, *found), Sheet.missing_sentences(lacking), "strain energy")


def _from_table(sources: Sources, *wanted: tuple[Any, ...]) -> tuple[list[SheetPanel], list[tuple[str, str]]]:
    """Return the panels of a figure for whose metrics the table of trials has values and, for each other panel, its
    letter and the input that it lacks.

    Args:
        sources: hold the table.
        wanted: of each panel the letter, the function that draws it from the table, and its metrics.
    """
    panels: list[SheetPanel] = []
    left_out: list[tuple[str, str]] = []
    for letter, draw, *metrics in wanted:
        if lacks := sources.missing_input(*metrics):
            left_out.append((letter, lacks))
        else:
            panels.append(SheetPanel.of_axes(letter, draw, sources.trials, *metrics))
    return panels, left_out
