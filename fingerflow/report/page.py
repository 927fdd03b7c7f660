"""HTML report of a result: one page that contains all figures, numbers and settings."""

import base64
import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from jinja2 import Environment
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fingerflow import plot
from fingerflow.errors import FingerflowError
from fingerflow.plot.abscissa import varies
from fingerflow.plot.axes_style import ONE_COLUMN_MM, TWO_COLUMNS_MM, figure_style
from fingerflow.plot.captions import caption_of, frame_text
from fingerflow.plot.figure_files import FigureFiles
from fingerflow.plot.picture import shown_views
from fingerflow.report.cautions import cautions, lost_points
from fingerflow.report.inline_svg import hover_curves, inline_svg
from fingerflow.report.key_frames import KeyFrame, key_frames
from fingerflow.report.key_numbers import QUANTITIES, key_numbers
from fingerflow.report.overlay import write_overlay
from fingerflow.report.practice_table import practice_tables
from fingerflow.report.settings_table import settings_tables, transform_rows
from fingerflow.report.slip_trials import SlipTrial, trial_figure, verdict_line
from fingerflow.results.atomic_write import MARK, is_marked, keep_others, spare, write_text
from fingerflow.schema.scene import Scene

_MAPS = ("divergence", "curl", "displacement", "strain_energy_density", "major_strain", "minor_strain", "decorrelation")
_BRIEF_MAPS = ("divergence", "displacement")
Draw = Callable[..., Axes]


@dataclass(frozen=True)
class Drawn:
    """Figure for the report page: unique name, SVG text, caption, and curve values to display at the cursor."""

    name: str
    svg: str
    caption: str
    curves: dict[str, Any] | None = None


# Figures that are shown together: their label, the figures, and the layout, a class of page.css.
Panel = tuple[str, list[Drawn], str]


@dataclass(frozen=True)
class Section:
    """Section of the report page: title, notes, and panels of which the reader sees one at a time."""

    title: str
    panels: list[Panel]
    notes: Sequence[str] = ()
    first: int = 0


@dataclass(frozen=True)
class _Figures:
    """Functions that draw the figures of one report page from `result`, and also write each as a file into `folder` if
    ``files`` is given.
    """

    result: xr.Dataset
    folder: Path
    files: FigureFiles | None
    overwrite: bool
    brief: bool

    def drawn(self, axes: Axes, name: str, label: str) -> Drawn:
        figure = axes.get_figure(root=True)
        assert isinstance(figure, Figure)
        drawn = self.whole(figure, name, label)  # drawn before `hover_curves`, as drawing settles the layout
        return replace(drawn, curves=hover_curves(axes, self.result.sizes["frame"]))

    def whole(self, figure: Figure, name: str, label: str) -> Drawn:
        svg = inline_svg(figure, name, label)
        if self.files is not None:
            self.files.keep_others(self.folder, name, self.overwrite)
            self.files.save(figure, self.folder, name)
        return Drawn(name, svg, caption_of(figure))

    def curves(
        self, title: str, drawings: Sequence[tuple[Draw, str]], notes: Sequence[str] = (), before: Sequence[Drawn] = ()
    ) -> Section | None:
        """Return a section of the page with one curve for each pair (drawing function, variable) in `drawings` whose
        variable has values in the result, after the figures `before`; None if there are neither.

        If the normal force varies, a second panel is against the other of force and time, but for a brief page.
        """
        result = self.result
        there = [(draw, name) for draw, name in drawings if name in result and np.isfinite(result[name].values).any()]
        if not there:
            return Section(title, [("", list(before), "grid")]) if before else None
        first, *_ = plot.abscissa(self.result)
        axes = [first]
        if varies(self.result, "normal_force") and not self.brief:
            axes.append("time" if first == "normal_force" else "normal_force")
        panels = [
            (f"against {plot.abscissa(self.result, against)[2]}", self.each(there, against=against), "grid")
            for against in axes
        ]
        panels[0][1][:0] = before
        return Section(title, panels, notes)

    def each(self, drawings: Sequence[tuple[Draw, str]], **settings: str) -> list[Drawn]:
        """Draw one figure for each pair (drawing function, variable) in `drawings`, passing the same settings, such as
        `against`, to every function.
        """
        figures = []
        for draw, variable in drawings:
            axes = draw(self.result, **settings)
            label = f"{axes.get_title()} against {axes.get_xlabel()}"
            figures.append(self.drawn(axes, "-".join((variable, *settings.values())), label))
        return figures


def write_report(
    result: xr.Dataset,
    scene: Scene | None,
    folder: Path,
    comparison: Sequence[Any] = (),
    brief: bool = False,
    overwrite: bool = False,
    figure_files: FigureFiles | None = None,
) -> Path:
    """Write the report of a result, report.html and overlay.mp4, into a folder and return the path of the page.

    Sections without variables in the result are left out.

    Args:
        result: result to report.
        scene: scene of the result; None leaves out pictures and video, as for a stream whose frames are gone.
        folder: folder to write into.
        comparison: rows with quantity, unit, measured, truth and error, of a synthetic recording.
        brief: write no overlay.mp4, which takes longer than all the rest, pictures and two maps of the largest load,
            and each curve once: the page of a trial of a study.
        overwrite: replace files that no report has written.
        figure_files: write each figure of the page also as a file, into the folder `figures`, in these formats.

    Raises:
        FingerflowError: before anything is computed, if the result has no frame, or an output is an input of the
            scene, or without ``overwrite`` a file that no report has written.
    """
    if not result.frame.size:
        raise FingerflowError(f"{folder}: the result has no frame to report; was the stream ended before its first?")
    for output in ("report.html", "overlay.mp4") if scene is not None else ("report.html",):
        spare(folder / output, *(scene.files() if scene is not None else ()))
        keep_others(folder / output, is_marked, overwrite)
    if scene is not None and not brief:
        write_overlay(result, scene, folder / "overlay.mp4")
    frames = key_frames(result)
    make = _Figures(result, folder / "figures", figure_files, overwrite, brief)
    with figure_style((figure_files and figure_files.width_mm) or ONE_COLUMN_MM):
        sections = _sections(make, scene, frames)
    seconds = json.loads(result.attrs.get("stage_seconds", "{}"))
    parts = files(__package__)
    figures = [figure for section in sections for _, shown, _ in section.panels for figure in shown]
    curves = {figure.name: figure.curves for figure in figures if figure.curves}
    numbers = result["frame"].values
    template = Environment(autoescape=True).from_string(parts.joinpath("page.html").read_text("utf-8"))
    html = template.render(
        mark=MARK,
        result=result,
        heading="/".join(re.split(r"[\\/]", str(result.attrs["frames"]))[-2:]),
        css=parts.joinpath("page.css").read_text("utf-8"),
        js=parts.joinpath("page.js").read_text("utf-8"),
        cautions=cautions(result),
        columns=[(why, int(numbers[frame])) for frame, why in frames],
        numbers=key_numbers(result, frames),
        quantities=QUANTITIES,
        comparison=comparison,
        sections=sections,
        lost=lost_points(result),
        calibration=[
            ("scale", f"{float(result.attrs['mm_per_px']):.5f} mm/px"),
            *transform_rows(result.attrs["topography_to_contact"]),
            ("strain measure", str(result.attrs["strain_measure"]).replace("_", " ")),
        ],
        calibration_picture=_calibration_picture(scene),
        practice=practice_tables(result, scene),
        settings=settings_tables(result.attrs["settings"]),
        stages=[(name, value, 1000 * value / len(numbers)) for name, value in seconds.items()],
        # Only "<" could end a script element, which has no escapes of its own, so it is written as a JSON escape.
        curves=json.dumps({**curves, "frames": numbers.tolist()}, separators=(",", ":")).replace("<", "\\u003c"),
    )
    path = folder / "report.html"
    write_text(path, html)
    return path


def _sections(make: _Figures, scene: Scene | None, frames: Sequence[KeyFrame]) -> list[Section]:
    result = make.result
    sections: list[Section | None] = []
    most = next((k for k, (_, why) in enumerate(frames) if why.startswith("largest")), len(frames) - 1)
    if make.brief:
        frames, most = frames[most : most + 1], 0
    if scene is not None:
        panels: list[Panel] = []
        for frame, why in frames or [(0, "first frame")]:
            drawn = []
            for view in shown_views(scene):
                axes = plot.picture(result, scene, frame, view=view)
                drawn.append(make.drawn(axes, f"picture-{view}-{frame}", f"{view} view"))
            panels.append((why, drawn, "grid pictures"))
        sections.append(Section("What was seen", panels, first=max(most, 0)))
    time_only = [(plot.forces, "normal_force"), (plot.load_ratio, "load_ratio")]
    loads = [pair for pair in time_only if pair[1] in result and (pair[1] == "normal_force" or varies(result, pair[1]))]
    contact = (plot.contact_area, "gross_contact_area"), (plot.contact_axes, "ellipse_semi_axes")
    sections.append(make.curves("Contact and load", contact, before=make.each(loads)))
    deformation = [
        (plot.median_divergence, "median_divergence"),
        (plot.median_strain, "median_strain"),
        (plot.strain_energy, "strain_energy"),
        (plot.displacement, "global_displacement"),
    ]
    since = result["median_divergence"].attrs.get("reference") if "median_divergence" in result else None
    counted = (f"Displacement counts from {since}.",) if since else ()
    sections.append(make.curves("Deformation, medians over the gross contact", deformation, counted))
    sections.append(_maps(make, result, frames, max(most, 0)))
    if "stuck_ratio" in result and "verdict" in result["stuck_ratio"].attrs:
        trial = SlipTrial.read(result, "Partial slip")
        wide_mm = (make.files and make.files.width_mm) or TWO_COLUMNS_MM
        slip = make.whole(trial_figure(trial, wide_mm), "partial-slip", verdict_line(trial))
        sections.append(Section(verdict_line(trial), [("", [slip], "strip")]))
    quality = [
        (plot.tracked_share, "tracked_share"),
        (plot.forward_backward, "forward_backward_median"),
        (plot.position_std, "position_std_px"),
    ]
    shown = [(draw, name) for draw, name in quality if name in result and bool((result[name] > 0).any())]
    if shown and not make.brief:
        sections.append(Section("Quality", [("", make.each(shown), "grid")]))
    return [section for section in sections if section is not None]


def _maps(make: _Figures, result: xr.Dataset, frames: Sequence[KeyFrame], first: int) -> Section | None:
    """Return the page's section with maps over the contact at the key frames `frames`, each quantity with one colour
    scale, or None without maps; the reader first sees frame number `first` of these.
    """
    indices = [frame for frame, _ in frames]
    shown = [result.isel(frame=index) for index in indices]
    drawable = [name for name in (_BRIEF_MAPS if make.brief else _MAPS) if name in plot.drawable(result)]
    there = [name for name in drawable if any(np.isfinite(plot.QUANTITIES[name].values(each)).any() for each in shown)]
    if not there or not indices:
        return None
    limits = {name: plot.colour_limit(result, name, indices) for name in there}
    panels: list[Panel] = []
    for (frame, why), data in zip(frames, shown, strict=True):
        drawn = []
        for name in there:
            axes = plot.field_map(result, name, frame, limit=limits[name])
            drawn.append(make.drawn(axes, f"map-{name}-{frame}", f"{plot.QUANTITIES[name].title}, {frame_text(data)}"))
        panels.append((why, drawn, "grid maps"))
    lines = "; lines lie along the principal strain" * ("principal_angle" in result)
    return Section("Maps on the skin", panels, (f"Dashed: gross contact. All frames have one scale{lines}.",), first)


def _calibration_picture(scene: Scene | None) -> str | None:
    """Return the overlay image (base64) that `fingerflow calibrate` wrote with the calibration; None if missing."""
    if scene is None or scene.calibration.file is None:
        return None
    path = scene.calibration.file.with_suffix(".png")
    return base64.b64encode(path.read_bytes()).decode("ascii") if path.is_file() else None
