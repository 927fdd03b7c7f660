"""Figures of a result: functions that draw into matplotlib axes and return them, for papers and for the report.

Example:
    ::

        import fingerflow
        from fingerflow import plot
        from pathlib import Path

        result = fingerflow.process("scene.toml")
        files = plot.FigureFiles(formats=("pdf", "svg"), width_mm=85)
        with plot.figure_style(85):  # of new figures: width in mm, type of 7 pt or more
            axes = plot.contact_area(result)  # against the force where it only rises or falls, else against time
        files.save(axes.figure, Path("figures"), "area")  # area.pdf, area.svg and the caption area.txt

        with plot.figure_style(180):
            figure, (left, right) = plot.row_of_panels(2, 180)
            plot.median_divergence(result, left.subplots(), against="time")
            plot.field_map(result, "major_strain", frame=200, axes=right.subplots())
        files.save(figure, Path("figures"), "strain")
"""

from fingerflow.plot.abscissa import abscissa
from fingerflow.plot.axes_style import figure_style
from fingerflow.plot.captions import caption_of
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
    strain_energy,
    tracked_share,
)
from fingerflow.plot.figure_files import FigureFiles
from fingerflow.plot.maps import QUANTITIES, colour_limit, drawable, field_map
from fingerflow.plot.panels import row_of_panels
from fingerflow.plot.picture import picture

__all__ = [
    "QUANTITIES", "FigureFiles", "abscissa", "caption_of", "colour_limit", "contact_area", "contact_axes",
    "displacement", "drawable", "field_map", "figure_style", "forces", "forward_backward", "load_ratio",
    "median_divergence", "median_strain", "picture", "position_std", "row_of_panels", "strain_energy", "tracked_share",
]  # fmt: skip
