"""Figures of a result: functions that draw into matplotlib axes and return them, for papers and for the report.

Example:
    ::

        import fingerflow
        from fingerflow import plot
        from matplotlib.figure import Figure

        result = fingerflow.process("scene.toml")
        axes = plot.contact_area(result)  # against the normal force where it only rises or falls, else against time
        axes.figure.savefig("area.pdf")

        figure = Figure(figsize=(7, 3), layout="constrained")
        left, right = figure.subplots(1, 2)
        plot.median_divergence(result, left, against="time")
        plot.field_map(result, "major_strain", frame=200, axes=right)
        figure.savefig("strain.svg")
"""

from fingerflow.plot.abscissa import abscissa
from fingerflow.plot.curves import (
    contact_area,
    contact_axes,
    displacement,
    forces,
    forward_backward,
    load_ratio,
    median_divergence,
    median_strain,
    position_std,
    slip_ratio,
    strain_energy,
    tracked_share,
)
from fingerflow.plot.maps import QUANTITIES, colour_limit, drawable, field_map
from fingerflow.plot.picture import picture

__all__ = [
    "QUANTITIES",
    "abscissa",
    "colour_limit",
    "contact_area",
    "contact_axes",
    "displacement",
    "drawable",
    "field_map",
    "forces",
    "forward_backward",
    "load_ratio",
    "median_divergence",
    "median_strain",
    "picture",
    "position_std",
    "slip_ratio",
    "strain_energy",
    "tracked_share",
]
