"""Printed results of Terekhov & Hayward 2011, each with the function that computes it from the simulated slides.

The model's equations are checked by quadrature and root finding, written here from the printed lines, against
`fingerflow.models.partial_slip`.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.optimize import brentq, minimize_scalar

from bench.papers.printed import Interval, Obtained, Row, exactly, likely, put_in, rounded
from bench.papers.slides import ABRUPT, EXPECTED, FADING, JudgedSlide, Slides
from fingerflow.models.partial_slip import critical_load_ratio, critical_stuck_area, friction_ratio, load_ratio
from fingerflow.models.partial_slip import stuck_area as stuck_area_at
from fingerflow.models.partial_slip.curve_families import EQUAL_FRICTION, TADA
from fingerflow.models.partial_slip.verdict import CORRIDOR, SMALLEST_AREA, TrialVerdict
from fingerflow.recordings import open_forces
from fingerflow.schema.rounding import format_uncertainty

Values = NDArray[np.float64]
_EXACT = 1e-6  # largest relative error of quadratures and roots
_STATIC, _KINETIC = 0.8, 0.4  # friction coefficients at which equations are checked; any pair with mu_k < mu_s would do


def _trials(slides: Slides) -> Obtained:
    count = len(slides.slides)
    return Obtained(f"{count}", exactly(count), "10", f"not measured: {'; '.join(slides.failed)}")


def _outcomes(slides: Slides) -> Obtained:
    verdicts = [one.trial.verdict for one in slides.slides]
    outcomes = [one.outcome for one in verdicts], [one.printed_outcome for one in verdicts]
    own, printed = (tuple(map(found.count, EXPECTED.values())) for found in outcomes)
    truth = tuple(len(slides.of(kind)) for kind in EXPECTED)
    text = f"{_with(own)}; by the printed rule {_with(printed)}"
    wrong = [one.trial.name for one in slides.slides if one.trial.verdict.outcome != EXPECTED[one.kind]]
    return Obtained(text, exactly(*own), _with(truth), f"misjudged: {', '.join(wrong)}")


def _with(counts: tuple[int, ...]) -> str:
    return f"{counts[0]} with, {counts[1]} without, {counts[2]} inconclusive"


def _abrupt(slides: Slides) -> list[JudgedSlide]:
    """Return the slides measured to lose their stuck area abruptly, in ascending order of the critical area: the
    relative stuck area at which the collapse begins.
    """
    found = [one for one in slides.slides if one.trial.verdict.outcome == EXPECTED[ABRUPT]]
    return sorted(found, key=lambda one: one.trial.verdict.critical_area)


def _critical_areas(slides: Slides) -> Obtained:
    printed = [one.trial.verdict.corridor_area for one in _abrupt(slides)]
    more, truth = (
        f"; largest value in the corridor {_ends(printed)}",
        _ends([one.truth.last for one in slides.of(ABRUPT)]),
    )
    return _least_and_largest(slides, lambda one: (one.critical_area, one.critical_area_std), more, truth)


def _extents(slides: Slides) -> Obtained:
    def extent(verdict: TrialVerdict) -> tuple[float, float]:
        return 100 * verdict.critical_extent, 100 * (verdict.critical_area_std / (2 * verdict.critical_extent))

    truth = _ends([100 * math.sqrt(one.truth.last) for one in slides.of(ABRUPT)], 1)
    return _least_and_largest(slides, extent, " %", f"{truth} %")


def _least_and_largest(
    slides: Slides, measured: Callable[[TrialVerdict], tuple[float, float]], more: str, truth: str
) -> Obtained:
    """Return a measured quantity of two slides, those that collapse from the least and from the largest stuck area;
    `measured` gives its value and SD, `more` follows in the text.
    """
    found = _abrupt(slides)
    if not found:
        return Obtained("", because="no slide was judged to vanish abruptly")
    ends = [measured(one.trial.verdict) for one in (found[0], found[-1])]
    text, numbers = " to ".join(format_uncertainty(*one) for one in ends) + more, tuple(likely(*one) for one in ends)
    return Obtained(text, numbers, truth, "the fitted area is off by more than its deviation")


def _durations(slides: Slides) -> Obtained:
    found = sorted((one.trial.verdict.collapse_ms, one.trial.verdict.collapse_ms_std, one) for one in _abrupt(slides))
    truth = ", ".join(f"{1000 * one.truth.collapse:.0f}" for *_, one in found)
    text = ", ".join(format_uncertainty(value, deviation) for value, deviation, _ in found)
    printed = ", ".join(f"{one.trial.verdict.corridor_ms:.0f}" for *_, one in found)
    numbers = tuple(likely(value, deviation) for value, deviation, _ in found)
    expected = len(slides.of(ABRUPT))
    return Obtained(
        f"{text} ms; from the largest d² in the corridor {printed} ms", numbers, f"{truth} ms",
        f"a fitted duration is off by more than its deviation, or no collapse found ({len(found)} of {expected})",
        agrees=None if len(found) == expected else False,
    )  # fmt: skip


def _existence(slides: Slides) -> Obtained:
    inside = [area for one in slides.of(FADING) if math.isfinite(area := one.trial.verdict.corridor_area)]
    text = f"d² > {SMALLEST_AREA:g}; largest d² in the corridor of the fading slides {_ends(inside)}"
    return Obtained(text, exactly(SMALLEST_AREA))


def _threshold(slides: Slides) -> Obtained:
    one = slides.slides[0]
    limit, pixel = 1000 * one.scene.slip.stuck_mm, 1000 * one.truth.mm_per_px
    more = [
        slide.truth.slow_share(frame, one.scene.slip.stuck_mm) - slide.truth.stuck_share(frame)
        for slide in slides.slides
        for frame in range(slide.truth.n_frames)
        if 0.05 < slide.truth.stuck_share(frame) < 0.95
    ]
    return Obtained(
        f"{limit:g} µm, a pixel of {pixel:g} µm (criterion displacement); the default criterion finds the border of "
        f"skin that has not slipped: d² by 40 µm is larger, by {np.mean(more):.2f} on average, {max(more):.2f} at most",
        exactly(limit, pixel),
    )


def _measured(slides: Slides) -> Obtained:
    errors = []
    for one in slides.slides:
        truth = np.array([one.truth.stuck_share(frame) for frame in range(one.truth.n_frames)])
        error = np.asarray(one.trial.result["stuck_ratio"]) - truth
        errors.append(error[np.isfinite(error) & (truth > 0)])
    every = np.concatenate(errors)
    return Obtained(
        f"mean error {every.mean():+.3f}, RMS error {np.sqrt(np.mean(every**2)):.3f} in {every.size} frames",
        truth="d² of each frame",
    )


def _imaging_rate(slides: Slides) -> Obtained:
    rates = [1 / float(np.median(np.diff(one.trial.result["time"]))) for one in slides.slides]
    return Obtained(f"{np.mean(rates):.4g} Hz", ((min(rates), max(rates)),))


def _force_rate(slides: Slides) -> Obtained:
    found, steady = [], []
    for one in slides.slides:
        assert one.scene.forces is not None
        forces = open_forces(one.scene.forces.file)
        found.append(1 / float(np.median(np.diff(forces.times))) / 1000)
        normal = np.asarray(one.trial.result["normal_force"])
        steady.append(float(np.nanstd(normal) / np.nanmean(normal)))
    text = f"{np.mean(found):.3g} kHz; N constant to {100 * max(steady):.1f} %"
    because = "the simulated sensor samples faster; forces are filtered to the frames of 60 Hz either way"
    return Obtained(text, ((min(found), max(found)),), because=because)


# Rows on the model, in units in which the contact is a disc of radius 1 and N is 1.


def _equal(text: str, error: float) -> Obtained:
    return Obtained(f"{text}, to {error:.1g}", because="the model differs", agrees=error < _EXACT)


def _term(text: str, static: float, kinetic: float, areas: tuple[float, ...]) -> Callable[[Slides], Obtained]:
    """Return the function that compares T/N of `load_ratio` at stuck areas d² with the printed traction, integrated
    over the disc.

    T/N is linear in both coefficients: its change by `static` and `kinetic` is the integral of their terms alone.
    """

    def obtain(_: Slides) -> Obtained:
        errors = []
        for area in areas:
            held = math.pi * area * _pressure(math.sqrt(area))  # equation 3: the static limit at the border d
            slipping = quad(lambda radius: 2 * math.pi * radius * _pressure(radius), math.sqrt(area), 1)[0]
            change = float(load_ratio(area, 1 + static, 1 + kinetic) - load_ratio(area, 1.0, 1.0))
            errors.append(abs(change - static * held - kinetic * slipping))
        return _equal(f"{text} of `load_ratio`, by quadrature", max(errors))

    return obtain


def _pressure(radius: float) -> float:
    """Return the contact pressure of equation 1 at a distance from the centre."""
    return 2 / math.pi * (1 - radius**2)


_AREAS = tuple(np.linspace(0.1, 0.9, 9))


def _law(_: Slides) -> Obtained:
    load = np.linspace(0, float(critical_load_ratio(_STATIC, _KINETIC)), 200)[:-1]
    area = stuck_area_at(load, _STATIC, _KINETIC).numpy()
    residual = (2 * _STATIC - _KINETIC) * area**2 - 2 * (_STATIC - _KINETIC) * area - _KINETIC + load
    return _equal("`stuck_area` solves equation 5, d = 1 without load", max(np.abs(residual).max(), abs(area[0] - 1)))


def _fold(_: Slides) -> Obtained:
    found = minimize_scalar(lambda area: -float(load_ratio(area, _STATIC, _KINETIC)), bounds=(0, 1), method="bounded",
                            options={"xatol": 1e-10})  # fmt: skip
    error = abs(found.x - float(critical_stuck_area(_STATIC, _KINETIC)))
    return _equal(f"{found.x:.4f} at the largest load (search)", error)


def _inversion(_: Slides) -> Obtained:
    area = float(critical_stuck_area(_STATIC, _KINETIC))
    solved = brentq(lambda ratio: float(critical_stuck_area(1.0, ratio)) - area, 1e-6, 1 - 1e-6, xtol=1e-12)
    printed = (1 - area) / (2 - area)
    return Obtained(
        f"{float(friction_ratio(area)):.3f} by (1 - 2 d²)/(1 - d²), {solved:.3f} by a root of A17, {printed:.3f} as "
        f"printed, for d² = {area:.3f}",
        truth=f"{_KINETIC / _STATIC:.3f}",
        because="the printed expression does not solve the line above it",
        agrees=abs(printed - solved) < _EXACT,
    )


def _equal_friction(_: Slides) -> Obtained:
    load = np.linspace(0, 1, 1001)
    area = stuck_area_at(load, 1.0, 1.0).numpy()
    away = np.abs(area - (1 - load))
    solves = float(np.abs(area**2 - (1 - load)).max())
    return Obtained(
        f"d⁴ = 1 - (T/N)/μ (to {solves:.1g}); the printed line is off by up to {away.max():.2f}, {away[950]:.2f} at "
        "the corridor's edge",
        because="with equal coefficients the term in d² drops out of equation 5, not the one in d⁴",
        agrees=float(away.max()) < _EXACT,
    )


def _tada(_: Slides) -> Obtained:
    area = np.linspace(0.1, 0.9, 50)
    slope = np.polyfit(np.log(1 - TADA.load(area)[:, 0]), np.log(area), 1)[0]
    beside = np.polyfit(np.log(1 - EQUAL_FRICTION.load(area)[:, 0]), np.log(area), 1)[0]
    return Obtained(f"exponent {slope:.4f}, beside {beside:.4f} of equation 5", ((slope - 1e-9, slope + 1e-9),))


def _condition(_: Slides) -> Obtained:
    def last(kinetic: float) -> float:
        return float(stuck_area_at(critical_load_ratio(_STATIC, kinetic), _STATIC, kinetic))

    less, more = last(0.5 * _STATIC), last(1.5 * _STATIC)
    return Obtained(
        f"d² at the largest load {less:.2f} for μk = 0.5 μs, {more:.2f} for μk = 1.5 μs: as the body, not the abstract",
        agrees=less > 0 and more == 0,
        because="the model has a minimal area where the body has none",
    )


def _shape(slides: Slides) -> Obtained:
    straight, parabola = [], []
    for one in slides.of(ABRUPT):
        verdict = one.trial.verdict
        area = np.asarray(one.trial.result["stuck_ratio"], dtype=float)[verdict.loading()]
        load = one.trial.load_ratio()[verdict.loading()]
        known = np.isfinite(area) & np.isfinite(load) & (area < 0.95)
        line = np.polynomial.Polynomial.fit(load[known], area[known], 1)
        straight.append(float(np.sqrt(np.mean((area[known] - line(load[known])) ** 2))))
        # Evaluate equation 5 at the measured critical area and load, which determine its two coefficients.
        ratio = friction_ratio(min(max(verdict.critical_area, 0.0), 0.5))
        static = verdict.loss_load_ratio * (2 - float(ratio))
        curve = stuck_area_at(np.minimum(load[known], verdict.loss_load_ratio), static, ratio * static).nan_to_num(0.0)
        parabola.append(float(np.sqrt(np.mean((area[known] - curve.numpy()) ** 2))))
    return Obtained(
        f"RMS distance of d² from a straight line {_ends(straight, 3)}, from equation 5 {_ends(parabola, 3)}",
        truth="straight lines",
        because="the slides are not nearer to a line than to equation 5",
        agrees=bool(straight) and max(straight) < min(parabola),
    )


def _ends(values: list[float], digits: int = 2) -> str:
    return f"{min(values):.{digits}f} to {max(values):.{digits}f}" if values else "none"


_DURATIONS = rounded(130, 150, 280, 310, digit=10)
_SIZE: tuple[Interval, ...] = ((31.0, 32.0), (58.0, 59.0))  # the printed percentages are truncated, not rounded

ROWS: tuple[Row[Slides], ...] = (
    put_in("A1", "trials", "10", "abstract, 2.2", exactly(10), _trials),
    put_in("A2", "outcome", "4 with minimal area, 4 without, 2 inconclusive", "abstract, 3", exactly(4, 4, 2),
        _outcomes),
    put_in("A3", "critical d²", "0.10 to 0.34", "2b, 3", rounded(0.10, 0.34, digit=0.01), _critical_areas),
    put_in("A4", "critical linear size", "31 to 58 %", "3", _SIZE, _extents),
    put_in("A5", "duration of the loss", "130, 150, 280, 310 ms", "2b, 3", _DURATIONS, _durations),
    Row("A6", "corridor", "±5 %", "2b", exactly(0.05),
        lambda _: Obtained(f"±{100 * CORRIDOR:g} %", exactly(CORRIDOR))),
    Row("A7", "existence threshold", "d² > 0.05", "2b", exactly(0.05), _existence),
    Row("A8", "stuck threshold", "< 40 µm (one pixel)", "1", exactly(40, 40), _threshold),
    Row("A9", "d² measured", "", "1", (), _measured),
    Row("A10", "imaging rate", "60 Hz", "2.2", rounded(60, digit=1), _imaging_rate),
    Row("A11", "force sampling", "1.0 kHz", "2.2", rounded(1.0, digit=0.1), _force_rate),
    Row("A12", "pressure", "p = 2N/(πab) (1 - x²/a² - y²/b²)", "Eq 1", (),
        _term("its integral is N: T/N μk where all skin slips,", 0.0, 1.0, (0.0,))),
    Row("A13", "traction", "q uniform where stuck, μk p where slipping", "Eq 2", (),
        _term("the integral of μk p where skin slips is the term in μk", 0.0, 1.0, _AREAS)),
    Row("A14", "stuck traction", "q = μs 2N/(πab) (1 - d²)", "Eq 3", (),
        _term("μs p at the border d, over the stuck area, is the term in μs", 1.0, 0.0, _AREAS)),
    Row("A15", "total T", "πab d² q + μk N (1 - d²)²", "Eq 4", (),
        _term("the integral of the traction is T/N", _STATIC, _KINETIC, _AREAS)),
    Row("A16", "law", "(2μs - μk) d⁴ - 2(μs - μk) d² = μk - T/N", "Eq 5", (), _law),
    Row("A17", "critical d² (model)", "(μs - μk)/(2μs - μk)", "2.1", (), _fold),
    Row("A18", "friction ratio from it", "μk/μs = (1 - d²)/(2 - d²)", "2.1", (), _inversion),
    Row("A19", "equal friction", "d² = 1 - (T/N)/μk", "2.1", (), _equal_friction),
    Row("A20", "earlier model", "exponent 2/3", "2.1", exactly(2 / 3), _tada),
    Row("A21", "condition for a minimal area", "μk < μs (body); μk > μs (abstract)", "1, 2.1", (), _condition),
    put_in("A22", "curve shape", "no parabolic decay", "3", (), _shape),
)  # fmt: skip
