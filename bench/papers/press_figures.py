"""Figures S1 to S13 and movies M1 to M4 of Willemet et al. 2021, drawn from the simulated study and from models."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace

import cv2
import numpy as np
from matplotlib.figure import SubFigure
from matplotlib.tri import Triangulation

from bench.papers import half_sphere, receptors
from bench.papers.chain import draw_fastest_point, draw_largest_displacement
from bench.papers.chain_movie import movie_pictures
from bench.papers.decomposition import decompose, draw_decomposition
from bench.papers.drawn import Drawn, Picture, PrintedFigure, new_frame, picture_of
from bench.papers.press_stages import contact_mask, contact_stages, difference_panel, show_contact, skin_stages
from bench.papers.presses import PressStudy, TypicalPress
from bench.papers.tribometer import draw_friction, draw_trace
from fingerflow import plot
from fingerflow.plot.axes_style import INK, ONE_COLUMN_MM, TWO_COLUMNS_MM
from fingerflow.plot.captions import caption_of, describe
from fingerflow.plot.outlines import matrix_of_view, to_pixels
from fingerflow.recordings import open_recording
from fingerflow.report.sheet import Sheet, SheetPanel
from fingerflow.report.supplement import supplement_sheet
from fingerflow.report.view_painter import ViewPainter
from fingerflow.study.figures import draw_curves

_FORCES_N = (1.0, 2.0, 3.0)
_STRAINS = ("exx", "eyy", "exy")
_PAINTED = ("position", "displacement", "ellipse_center", "ellipse_semi_axes", "ellipse_angle")  # in movie M1
_MOVIE_MAPS = (*_STRAINS, "strain_energy_density")
_CHAIN_STEP = 4  # every 4th simulated time of the chain is shown in movie M3
_MOVIE_FORCES = 12  # number of normal forces in movie M4
_ARROWS = 10.0  # magnification of displacements in movie M1
# Metrics that the paper draws against force, by the letters of their panels.
_CURVES = {"S8": {"E": "strain", "F": "strain_rate"}, "S9": {"B": "strain_energy", "C": "strain_energy_rate"}}
_STACKED = 1.6  # height of a panel with several axes relative to one with a single axis
_MAPS = "maps since each point's own onset; the rest, by the printed analysis, is of the study"


def _sheet(name: str, panels: list[SheetPanel], shown: str) -> Drawn:
    width = ONE_COLUMN_MM if [one.columns for one in panels] == [1] else TWO_COLUMNS_MM
    figure = Sheet(name, tuple(panels)).figure(width)
    _, *captions = caption_of(figure).splitlines()  # omits the heading
    return figure, "\n".join((shown, *captions))


def _of_trials(study: PressStudy, name: str) -> list[SheetPanel]:
    """Return the panels of the supplement's figure `name`, such as "S5", that the study supports: curves against force,
    and those of the table of trials.
    """
    curves = (_curve(study, *curve) for curve in _CURVES.get(name, {}).items())
    return [*curves, *supplement_sheet(name, study.sample.trials).panels]


def _supplement(name: str, shown: str = "Of the study, {count}.") -> Callable[[PressStudy], Drawn]:
    """Return the function that draws the supplement's figure `name`, such as "S7", from a study; `shown` is the first
    line of its caption, with ``{count}`` for the number of trials.
    """
    return lambda study: _sheet(name, _of_trials(study, name), shown.format(count=_count(study)))


def _curve(study: PressStudy, letter: str, metric: str) -> SheetPanel:
    return SheetPanel.single(letter, draw_curves, study.curves, metric)


def _count(study: PressStudy) -> str:
    people = study.frame["participant"].nunique()
    return f"{study.sample.used} answered trials, {len(study.measured)} presses of {people} participants"


def _friction_and_area(study: PressStudy) -> Drawn:
    trials = study.sample.trials
    at_3n = {area: study.column_of_sample(f"{area}_at_3n") for area in ("gross_contact_area", "real_contact_area")}
    panels = [
        SheetPanel("A", lambda part: draw_trace(part.subplots(4, 1, sharex=True), study.trace), 2, 1.4),
        SheetPanel.single("B", draw_friction, study.trace.epochs),
        *supplement_sheet("S1", replace(trials, metrics={**trials.metrics, **at_3n})).panels,
        _curve(study, "C", "gross_contact_area"),
        _curve(study, "E", "real_contact_area"),
    ]
    high, low = study.typical
    moments = [(force, high.frame_at(force), low.frame_at(force)) for force in _FORCES_N]
    pairs = [
        (force, contact_mask(high.result, high.scene, one), contact_mask(low.result, low.scene, other))
        for force, one, other in moments
        if one is not None and other is not None
    ]
    panels += [difference_panel(pairs)] if pairs else []
    return _sheet(
        "S1",
        sorted(panels, key=lambda panel: panel.letter),
        f"Friction is that of a simulated tribometer trace; areas are those of the study, by amplitude at 3 N: "
        f"{_count(study)}. Bars are mean ± SD, bands of curves 95 %, both over participants.",
    )


def _stages(study: PressStudy) -> Drawn:
    _, low = study.typical
    first = int(np.flatnonzero(np.nan_to_num(low.result["gross_contact_area"]) > 0)[0])
    frame = low.frame_at(min(3.0, low.largest_force)) or low.peak
    panels = contact_stages(low.result, low.scene, frame) + skin_stages(low.result, low.scene, frame, first)
    force = float(low.result["normal_force"][frame])
    return _sheet("S3", panels, f"One simulated press at {force:.1f} N, skin since each point's own onset.")


def _half_sphere(_: PressStudy) -> Drawn:
    draws = half_sphere.draw_half_sphere, half_sphere.draw_lengths, half_sphere.draw_radial_strain
    panels = [SheetPanel.single(letter, draw) for letter, draw in zip("ABC", draws, strict=True)]
    return _sheet("S4", panels, "From the closed form.")


def _kinematics(study: PressStudy) -> Drawn:
    high, _ = study.typical
    panels = [
        SheetPanel.single("A", lambda axes: plot.forces(high.result, axes)),
        *_of_trials(study, "S5"),
        SheetPanel.single("J (skin chain)", draw_largest_displacement, study.chain),
        SheetPanel.single("K (skin chain)", draw_fastest_point, study.chain),
    ]
    return _sheet("S5", panels, f"Of the study, {_count(study)}; the chain's panels are of the model alone.")


def _decomposition(study: PressStudy) -> Drawn:
    _, low = study.typical
    moved = low.result["displacement"].values[low.peak]
    found = decompose(low.result["position"].values[low.peak] - moved, moved)
    panel = SheetPanel("", lambda part: draw_decomposition(part, found), columns=3, rows=1.8)
    return _sheet("S6", [panel], "A press at low friction, at its largest force, since each point's own onset.")


def _strain(study: PressStudy) -> Drawn:
    high, low = study.typical
    limit = max(plot.colour_limit(one.result, name, (one.peak,)) for one in (high, low) for name in _STRAINS)
    panels = [
        SheetPanel("A, C", lambda part: _triangulated(part, low, high), columns=3, rows=0.8),
        SheetPanel("B", lambda part: _strain_maps(part, low, "low", limit), columns=3),
        SheetPanel("D", lambda part: _strain_maps(part, high, "high", limit), columns=3),
        *_of_trials(study, "S8"),
    ]
    return _sheet(
        "S8", panels,
        f"Pictures and maps are of two presses of one participant, at {low.largest_force:.1f} N (low friction) and "
        f"{high.largest_force:.1f} N (high friction), {_MAPS}: {_count(study)}.",
    )  # fmt: skip


def _strain_energy(study: PressStudy) -> Drawn:
    high, low = study.typical
    panels = [SheetPanel("A", lambda part: _energy_maps(part, high, low), columns=2), *_of_trials(study, "S9")]
    return _sheet("S9", panels, f"Two presses of one participant, {_MAPS}: {_count(study)}.")


def _receptors(study: PressStudy) -> Drawn:
    chain, depth = study.chain, study.depth
    panels = [
        SheetPanel("A", lambda part: receptors.draw_evolution(part, chain), rows=_STACKED),
        SheetPanel("B", lambda part: receptors.draw_surface(part, chain), rows=_STACKED),
        SheetPanel("C", lambda part: receptors.draw_stress_map(part, chain, depth), rows=_STACKED),
        SheetPanel("D", lambda part: receptors.draw_receptor_stress(part, chain, depth), rows=_STACKED),
        SheetPanel("E", lambda part: receptors.draw_strain_in_time(part, chain, depth)),
        SheetPanel.single("F", receptors.draw_compression, chain, depth),
    ]
    return _sheet("S10", panels, "The skin chain with the stiffness that gives the printed area, 3 N.")


def _curl(study: PressStudy) -> Drawn:
    _, low = study.typical
    panels = [
        SheetPanel.single("A", lambda axes: plot.field_map(low.result, "curl", low.peak, axes)),
        *map(_of_script, (_curve(study, "B", "curl"), *_of_trials(study, "S13"))),
    ]
    return _sheet("S13", panels, f"A press at low friction, {_MAPS}: {_count(study)}.")


def _of_script(panel: SheetPanel) -> SheetPanel:
    """Return a panel of curl whose labels state that the lab's script computes u_x - u_y."""

    def draw(part: SubFigure) -> None:
        panel.draw(part)
        axes, caption = part.axes[0], caption_of(part)
        axes.set_ylabel(axes.get_ylabel().replace("curl", "script's curl,\nu_x - u_y"))
        describe(axes, caption.replace("Curl", "Script's curl, u_x - u_y").replace("median curl", "median"))

    return replace(panel, draw=draw)


def _since_own_onset(name: str) -> PrintedFigure[PressStudy]:
    """Return figure `name`, such as "S8", by the analysis of this engine."""

    def draw(study: PressStudy) -> Drawn:
        assert study.own is not None  # of the study by the printed analysis, which is drawn
        return _sheet(name, _of_trials(study.own, name), f"Since each point's own onset: {_count(study)}.")

    return PrintedFigure(f"{name}-own-onset", f"figure {name}, counted otherwise", draw)


def _triangulated(part: SubFigure, low: TypicalPress, high: TypicalPress) -> None:
    """Draw both views of two presses at their largest forces, the topography view with the triangles between the
    tracked points.
    """
    grid = part.subplots(1, 4)
    for pair, press, friction in zip((grid[:2], grid[2:]), (low, high), ("low", "high"), strict=True):
        for axes, view in zip(pair, ("contact", "topography"), strict=True):
            show_contact(axes, press.result, press.scene, view, press.peak)
            axes.set_title(f"{friction} friction")
        places = to_pixels(press.result["position"].values[press.peak], matrix_of_view(press.result, "topography"))
        x, y = np.nan_to_num(places).T
        corners = press.result["triangles"].values
        whole = np.isfinite(places[corners]).all((1, 2))
        pair[1].triplot(Triangulation(x, y, corners[whole]), color=INK, linewidth=0.3)
    describe(grid[0], "Contact and topography view at the largest force, with the triangles between tracked points.")


def _strain_maps(part: SubFigure, press: TypicalPress, friction: str, limit: float) -> None:
    for axes, name in zip(part.subplots(1, 3), _STRAINS, strict=True):
        plot.field_map(press.result, name, press.peak, axes, limit)
        axes.set_title(f"{name}, {friction} friction")


def _energy_maps(part: SubFigure, high: TypicalPress, low: TypicalPress) -> None:
    name = "strain_energy_density"
    limit = max(plot.colour_limit(one.result, name, (one.peak,)) for one in (high, low))
    for axes, one, friction in zip(part.subplots(1, 2), (high, low), ("high", "low"), strict=True):
        plot.field_map(one.result, name, one.peak, axes, limit).set_title(f"{friction} friction")


# Movies


def _processed_frames(study: PressStudy, *shown: str) -> Iterator[Picture]:
    """Yield the frames of movies M1 and M2: a press at high friction above one at low friction, at the same normal
    forces, with contact outlines and displacement arrows where `shown`, the drawn variables, has them.
    """
    with ExitStack() as opened:
        painters = []
        for one, friction in zip(study.typical, ("high", "low"), strict=True):
            recording = one.scene.recording
            frames = opened.enter_context(open_recording(recording.frames, frame_rate=recording.frame_rate))
            painter = ViewPainter(one.result[list(shown)], one.scene, frames)
            painter.paint(one.peak)  # the peak frame sets the contrast
            painters.append((painter, one, f"{friction} friction"))
        for force in np.linspace(0.2, min(one.largest_force for one in study.typical), 40).tolist():
            pictures = []
            for painter, one, words in painters:
                pictures.append(painter.paint(one.frame_at(force) or one.peak, _ARROWS))
                cv2.putText(pictures[-1], f"{words}, {force:.1f} N", (12, 34), 0, 1.1, (255, 255, 255), 2, cv2.LINE_AA)
            yield np.concatenate(pictures)


def _strain_frames(study: PressStudy) -> Iterator[Picture]:
    """Yield the frames of movie M4: maps of strain and energy density of a press at high friction above those of one at
    low friction, at the same normal forces.
    """
    pair = study.typical
    limits = {name: max(plot.colour_limit(one.result, name, (one.peak,)) for one in pair) for name in _MOVIE_MAPS}
    limits |= dict.fromkeys(_STRAINS, max(limits[name] for name in _STRAINS))
    figure = new_frame()
    for force in np.linspace(0.5, min(one.largest_force for one in pair), _MOVIE_FORCES):
        figure.clear()
        figure.subplots_adjust(left=0.08, right=0.95, wspace=0.7, hspace=0.65)
        for row, one, friction in zip(figure.subplots(2, 4), pair, ("high", "low"), strict=True):
            for axes, name in zip(row, _MOVIE_MAPS, strict=True):
                plot.field_map(one.result, name, one.frame_at(float(force)) or one.peak, axes, limits[name])
                axes.set(xlabel="", ylabel="")
                axes.locator_params(nbins=3, integer=True)
            row[0].set(xlabel="x (mm)", ylabel=f"{friction} friction\ny (mm)")
        figure.suptitle(f"{force:.2f} N")
        yield picture_of(figure)


def _movie_contact(study: PressStudy) -> Drawn:
    largest = min(one.largest_force for one in study.typical)
    shown = f"Above high, below low friction, at the same forces up to {largest:.1f} N; displacements {_ARROWS:g} x."
    return _processed_frames(study, *_PAINTED), shown


def _movie_chain(study: PressStudy) -> Drawn:
    presses = study.chain
    friction = f"{min(presses.friction):g} and {max(presses.friction):g}"
    return movie_pictures(presses, _CHAIN_STEP), f"The chain at friction {friction}, up to {presses.force[-1]:g} N."


FIGURES: tuple[PrintedFigure[PressStudy], ...] = (
    PrintedFigure("S1", "A: sliding trial in time; B: friction against α; C, D: apparent area; E, F: real area, with "
                  "difference images at 1, 2, 3 N", _friction_and_area),
    PrintedFigure("S2", "A: rail, 30°; B: friction reduction device and optics",
                  lambda _: (None, "Photographs of the apparatus, which is not simulated.")),
    PrintedFigure("S3", "A1 to 6: raw, normalised, subtracted and filtered, binarised, opened with ellipse, area "
                  "against force; B1 to 6: raw, enhanced, features, tracks, divergence map and median", _stages),
    PrintedFigure("S4", "A: finger geometry; B: L, a against δ; C: strain against δ",
                  _half_sphere),
    PrintedFigure("S5", "A: force in time; B, C, D: histograms of force, time to maximum, duration; E to G, I: "
                  "answers; H: force rate; J: largest displacement; K: speed of the furthest point", _kinematics),
    PrintedFigure("S6", "displacement field split into conservative components", _decomposition),
    PrintedFigure("S7", "A: global displacement, B: peak force angle by α; C to E: answers", _supplement("S7")),
    PrintedFigure("S8", "A, C: images with triangulation, low and high friction; B, D: strain maps; E, F: strains and "
                  "rates by α; G: strain against divergence; H, I: answers", _strain),
    PrintedFigure("S9", "A: energy density, high and low friction; B, C: energy, its rate against force by α; D: energy"
                  " against divergence; E: answers", _strain_energy),
    PrintedFigure("S10", "A: pressure and deformation; B: surface stresses; C: stress maps with receptors; D: stresses "
                  "at depth; E: strains in time; F: compression", _receptors),
    PrintedFigure("S11", "A: Gaussian fits over normalised divergence; B: ROC; C: d' and AUC",
                  _supplement("S11", "Of the study, {count}; intervals are of 95 %.")),
    PrintedFigure("S12", "A: histogram of median divergence difference; B: answers by group; C: at small α",
                  _supplement("S12")),
    PrintedFigure("S13", "A: curl map; B: median curl against force; C: curl against divergence", _curl),
    *map(_since_own_onset, ("S8", "S9", "S11", "S12", "S13")),  # curl is 0 but for noise
    PrintedFigure("M1", "processed contact area and feature displacements, high and low friction", _movie_contact, 3),
    PrintedFigure("M2", "protocol; contact and ridge images", lambda study: (
        _processed_frames(study), "Both views, above high, below low friction; the protocol is not simulated."), 3),
    PrintedFigure("M3", "deformation of the surface finger model", _movie_chain, 4),
    PrintedFigure("M4", "surface strains and energy density, high and low friction", lambda study: (
        _strain_frames(study), "Strains and energy density since each point's own onset, at the same forces."), 8),
)  # fmt: skip
