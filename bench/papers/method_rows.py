"""Printed settings, equations and models of Willemet et al. 2021, each with the function that reproduces it."""

import inspect
import math
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.integrate import simpson
from scipy.optimize import brentq

from bench.papers.chain import HIGH, LOW
from bench.papers.half_sphere import DEPTH_MM, RADIUS_MM
from bench.papers.press_stages import contact_mask
from bench.papers.presses import DIVERGENCE_UNIT, PressStudy
from bench.papers.printed import Obtained, Row, exactly, predicted, rounded, unobtainable
from bench.papers.receptors import Depth
from bench.papers.tribometer import MODULATION_HZ
from fingerflow.calibration.registration import fit_affine
from fingerflow.models.half_space import stress
from fingerflow.models.hemisphere import radial_strain
from fingerflow.models.observer.trials_table import MOVED_MM
from fingerflow.models.skin_chain import press
from fingerflow.models.skin_parameters import PARAMETERS
from fingerflow.models.viscoelastic import RECEPTOR_DEPTHS_M, viscoelastic_strain
from fingerflow.ops.fields.strain import green_lagrange, strain_energy_density
from fingerflow.schema.rounding import format_uncertainty
from fingerflow.schema.variables import VARIABLES
from fingerflow.synthetic import Press

Values = NDArray[np.float64]
_PAPER = PARAMETERS["paper"]
_ELEMENTS = 501
_SPACING = math.pi * float(_PAPER.radius) / (_ELEMENTS - 1)  # m, between elements on the half circle
_STEP_S = 2.5e-6  # s, printed time step
_EXACT = 1e-9


def _modulation(study: PressStudy) -> Obtained:
    amplitude = study.trace.amplitude
    step = float(study.trace.time[1] - study.trace.time[0])
    power = np.abs(np.fft.rfft(amplitude - amplitude.mean()))
    found = float(np.fft.rfftfreq(amplitude.size, step)[power.argmax()])
    count = len(study.trace.epochs.start)
    return Obtained(f"{found:.2f} Hz; {count} epochs", ((found, found),), f"{MODULATION_HZ:g} Hz")


def _sliding_force(study: PressStudy) -> Obtained:
    mean, spread = float(study.trace.normal.mean()), float(study.trace.normal.std())
    return Obtained(f"{format_uncertainty(mean, spread)} N", ((mean - spread, mean + spread),))


def _friction(study: PressStudy) -> Obtained:
    epochs = study.trace.epochs
    median = epochs.over_epochs()[0].numpy()
    middles = 1e6 * (epochs.edges[1:] + epochs.edges[:-1]).numpy() / 2
    truth = study.design.friction_for(middles)
    rms = np.sqrt(np.mean((median - truth) ** 2))
    text = (
        f"{median[0]:.3f} to {median[-1]:.3f} in bins of {middles[0]:.2f} to {middles[-1]:.2f} µm; RMS error {rms:.3f}"
    )
    return Obtained(text, truth=f"{truth[0]:.3f} to {truth[-1]:.3f}")


def _reflection(_: PressStudy) -> Obtained:
    share = 100 * ((1.5 - 1) / (1.5 + 1)) ** 2
    return Obtained(f"{share:.1f} % by Fresnel's equation for an index of 1.5", exactly(share))


def _camera(study: PressStudy) -> Obtained:
    rig, used = Press(), study.truth_of(study.manifest.trials[0])
    (rows, columns), view = (scene.views["contact"].shape for scene in (rig, used))
    size = rows * rig.mm_per_px, columns * rig.mm_per_px
    return Obtained(
        f"{rig.frame_rate:g} fps, {rows} x {columns} px, {size[0]:.1f} x {size[1]:.1f} mm by default; here, to be "
        f"small, {used.frame_rate:g} fps, {view[0]} x {view[1]} px of {1000 * used.mm_per_px:.1f} µm",
        exactly(rig.frame_rate, rows, columns, *size),
        because="16 mm over 512 px and 21 mm over 640 px are 31.2 and 32.8 µm: pixels are square, of 32.5 µm here",
    )


def _median_filter(study: PressStudy) -> Obtained:
    size = study.scene.contact.median_px
    high, _ = study.typical
    areas = {side: int(contact_mask(high.result, high.scene, high.peak, side).sum()) for side in (size, 9, 11)}
    less = {side: 100 * (1 - area / areas[size]) for side, area in areas.items()}
    return Obtained(
        f"{size} x {size}; any odd size is a setting (contact.median_px)", exactly(size),
        because=f"a median rounds the ends of ridges: 9 x 9 takes {less[9]:.0f} % of the real area of a press, and "
        f"11 x 11, the radius of 5 of the figure, {less[11]:.0f} %",
    )  # fmt: skip


def _setting(text: str, values: Callable[[PressStudy], tuple[float, ...]]) -> Callable[[PressStudy], Obtained]:
    """Return the function that states settings of the study as a reproduced result: `text`, in which ``{}`` stand for
    the numbers that `values` returns.
    """

    def obtain(study: PressStudy) -> Obtained:
        found = values(study)
        return Obtained(text.format(*found), exactly(*found))

    return obtain


def _registration(study: PressStudy) -> Obtained:
    matrix = np.array(study.scene.calibration.topography_to_contact)
    points = np.array([(60.0, 50.0), (240.0, 70.0), (120.0, 210.0)])
    error = float(np.abs(fit_affine(points, points @ matrix[:, :2].T + matrix[:, 2]).matrix - matrix).max())
    text, because = f"affine map from 3 discs, to {error:.1g}", "the map is not recovered"
    return Obtained(text, agrees=error < _EXACT, because=because)


def _features(study: PressStudy) -> Obtained:
    most = study.scene.tracking.points
    counts = [len(one.result["position"][0]) for one in study.typical]
    return Obtained(f"{most} at most; {min(counts)} to {max(counts)} here", exactly(most))


def _displacement(study: PressStudy) -> Obtained:
    moved = study.pictured["global_displacement"] - study.pictured["true_displacement"]
    rms = float(np.sqrt((moved**2).mean()))
    return Obtained(f"median over the contact, RMS error {1000 * rms:.1f} µm in {len(moved)} presses")


def _divergence(study: PressStudy) -> Obtained:
    spread = study.pictured["divergence"] - study.pictured["true_divergence"]
    shown = VARIABLES["median_divergence"].shown_values
    mean, rms = shown(float(spread.mean())), shown(float(np.sqrt((spread**2).mean())))
    errors = f"mean error {mean:+.2f}, RMS error {rms:.2f} {DIVERGENCE_UNIT} in {len(spread)} presses"
    return Obtained(f"local plane fits; median over the contact, {errors}")


def _strains(study: PressStudy) -> Obtained:
    gradient = torch.tensor(np.random.default_rng(1).normal(scale=0.1, size=(50, 2, 2)))
    (ux, uy), (vx, vy) = (row.unbind(-1) for row in gradient.unbind(-2))
    printed = torch.stack((ux + (ux**2 + vx**2) / 2, vy + (uy**2 + vy**2) / 2, (uy + vx) / 2), -1)
    error = float((green_lagrange(gradient, "as_printed") - printed).abs().max())
    other = float((green_lagrange(gradient) - printed).abs().max())
    more = f"adds (u_x u_y + v_x v_y)/2 to ε_xy: {other:.3f} at most for gradients of 0.1"
    text = f"measure as_printed, to {error:.1g}; {study.scene.fields.strain}, used here, {more}"
    return Obtained(text, agrees=error < _EXACT)


def _energy_density(study: PressStudy) -> Obtained:
    modulus, nu = study.scene.fields.young_modulus_mpa, study.scene.fields.poisson_ratio
    strain = torch.tensor(np.random.default_rng(2).normal(scale=0.05, size=(50, 3)))
    xx, yy, xy = strain.unbind(-1)
    printed = (
        modulus * (1 - nu) / (2 * (1 + nu) * (1 - 2 * nu)) * (xx**2 + yy**2)
        + modulus * nu / ((1 + nu) * (1 - 2 * nu)) * xx * yy
        + modulus / (1 + nu) * xy**2
    )
    error = float((strain_energy_density(strain, modulus, nu) / printed - 1).abs().max())
    return Obtained(f"the same, to {error:.1g}", agrees=error < _EXACT)


def _membrane(_: PressStudy) -> Obtained:
    own = float(PARAMETERS["fitted"].membrane_stiffness) / 1000
    return Obtained(f"{own:g} kN/m, also where the tissue is fitted to the area", exactly(own))


def _tissue(_: PressStudy) -> Obtained:
    load = torch.tensor(3.0, dtype=torch.float64)
    own, fitted = (float(PARAMETERS[one].tissue_stiffness) / 1000 for one in ("paper", "fitted"))
    area, larger = (math.pi * (500 * float(press(HIGH, one, load).contact_length)) ** 2 for one in ("paper", "fitted"))
    text = f"{own:g} kN/m presses {area:.0f} mm² at 3 N, {fitted:.2g} kN/m that stiffen {larger:.0f} mm²"
    return Obtained(text, exactly(own))


def _damping(_: PressStudy) -> Obtained:
    damping = float(_PAPER.damping)
    response = 1000 * damping / float(_PAPER.tissue_stiffness)
    because = "10 ms is not ζ/k_t of the printed numbers in any unit that makes k_t 0.13 kN/m"
    return Obtained(f"ζ = {damping:g} N s/m; ζ/k_t = {response:.2f} ms", exactly(damping, response), because=because)


def _internal_force(_: PressStudy) -> Obtained:
    # Second differences of a long chain have eigenvalues from -4, of neighbours that move apart, to 0.
    membrane, tissue, damping = (float(getattr(_PAPER, name)) for name in _OF_CHAIN)
    right, printed = -tissue / damping, (4 * membrane - tissue) / damping
    text = f"+k_m (U_i-1 - 2 U_i + U_i+1): largest growth rate {right:.3g} 1/s, as printed {printed:+.3g} 1/s"
    return Obtained(text, because="with the printed sign of k_m a disturbance grows", agrees=printed < 0)


_OF_CHAIN = "membrane_stiffness", "tissue_stiffness", "damping"


def _motion(study: PressStudy) -> Obtained:
    chain = study.chain.chain
    left = float((chain.balance[-1] / study.chain.force[-1]).max())
    text = f"implicit steps with error control; unbalanced forces {left:.1g} of the load at the end of a press"
    because = "the printed lines are explicit Euler steps under the name Runge-Kutta, and change the sign of F_ext"
    return Obtained(text, because=because, agrees=False)


def _speed(_: PressStudy) -> Obtained:
    fastest = _SPACING / _STEP_S
    text = f"C_max = 1 allows {fastest:.0f} m/s with elements {1e6 * _SPACING:.0f} µm apart and steps of 2.5 µs"
    because = f"440 m/s would need elements {440 * 1e3 * _STEP_S:.1f} mm apart"
    return Obtained(text, exactly(2.5, fastest), because=because)


def _elements(_: PressStudy) -> Obtained:
    spacing = 1000 * _SPACING
    text = f"{_ELEMENTS} elements, {spacing:.3f} mm apart on a half circle of {1000 * float(_PAPER.radius):g} mm"
    because = f"{_ELEMENTS} elements 1.1 mm apart are {(_ELEMENTS - 1) * 1.1:.0f} mm of skin"
    return Obtained(text, exactly(spacing, _ELEMENTS), because=because)


def _compression(_: PressStudy) -> Obtained:
    share = 100 * float(radial_strain(DEPTH_MM, RADIUS_MM))
    implied = brentq(lambda radius: float(radial_strain(DEPTH_MM, radius)) - 0.1, 5.0, 20.0)
    return Obtained(f"{share:.1f} % for R = {RADIUS_MM:g} mm; 10 % for R = {implied:.1f} mm", ((share, share),))


def _default(of: Callable[..., object], name: str) -> float:
    return float(inspect.signature(of).parameters[name].default)


def _cut_off(_: PressStudy) -> Obtained:
    rate = _default(viscoelastic_strain, "rate")
    corner = rate / (2 * math.pi)
    return Obtained(
        f"E/η = {rate:g} 1/s: {1000 / rate:g} ms, {corner:.1f} Hz", ((corner, corner),),
        because="100 1/s is an angular frequency, as the response time of 10 ms shows",
    )  # fmt: skip


def _deep_stresses(_: PressStudy) -> Obtained:
    """Compare the closed-form stresses below a uniformly loaded strip of the surface with numerical integration of
    equation 11, and of the shear stress that it lacks.
    """
    y, z, half, p, q = 0.7, 0.5, 1.0, 3.0, 2.0
    found = stress(y, z, torch.tensor([-half, half]), torch.tensor([p]), torch.tensor([q]))
    at = np.linspace(-half, half, 20_001)
    r = y - at
    kernels = p * z * r**2 + q * r**3, p * z**3 + q * z**2 * r, p * z**2 * r + q * z * r**2
    printed = [-2 / math.pi * simpson(kernel / (r**2 + z**2) ** 2, x=at) for kernel in kernels]
    error = float(np.abs(np.array(found) / printed - 1).max())
    text = f"closed forms, to {error:.1g} of a quadrature of equation 11; τ_yz beside them"
    return Obtained(text, agrees=error < _EXACT)


def _gains(quantity: str, values_of: Callable[[Depth], Values]) -> Callable[[PressStudy], Obtained]:
    """Return the function that compares the gain of a quantity (K,), one value per simulated friction, at high over low
    friction, in percent, with the printed one.
    """

    def obtain(study: PressStudy) -> Obtained:
        ratios = study.chain.gains(values_of(study.depth))
        text = "; ".join(f"{ratio:.3f} over {one:g}" for one, ratio in ratios.items())
        return Obtained(
            f"{quantity}, friction {HIGH:g}: {text}", exactly(100 * (ratios[LOW] - 1)),
            because="only skin that slips mobilises traction, and all sticks above a friction of 0.2: friction times "
            "pressure everywhere, of half-width 4.2 mm, gives 20 % at 0.41",
        )  # fmt: skip

    return obtain


def _exclusion(study: PressStudy) -> Obtained:
    left_out = study.statistics["observer"]["left_out"]
    return Obtained(f"{MOVED_MM:g} mm; {left_out} of {study.sample.used} trials left out", exactly(MOVED_MM))


ROWS: tuple[Row[PressStudy], ...] = (
    Row("B1", "friction test modulation", "4 Hz", "Friction modulation", rounded(4, digit=1), _modulation),
    Row("B2", "force resolution", "< 1 mN", "Friction modulation", (), unobtainable(
        "a property of the instrument, a Fabry-Perot tribometer; nothing of the simulation depends on it")),
    Row("B3", "sliding normal force", "about 0.5 N", "Friction modulation", rounded(0.5, digit=0.1), _sliding_force),
    Row("B4", "friction coefficient", "", "S1A, S1B", (), _friction),
    Row("B10", "lights", "450 nm at 20°; 660 nm coaxial; dichroic 550", "Images", (), unobtainable(
        "cameras are simulated in grey levels; wavelengths and angles of the lamps are no settings")),
    Row("B11", "glass reflection", "4 %", "Images", rounded(4, digit=1), _reflection),
    Row("B12", "camera", "300 fps, 512 x 640 px, 16 x 21 mm", "Images", (
        *exactly(300, 512, 640), *rounded(16, 21, digit=1)), _camera),
    Row("B13", "finger angle", "30°", "S2A", (), unobtainable(
        "the simulated finger is axisymmetric about the normal: it has no inclination")),
    Row("B14", "median filter", "9 x 9 (text); radius 5 (S3A)", "Images, S3A", exactly(9), _median_filter),
    Row("B15", "apparent area", "radius 8 px, then ellipse", "Images, S3A", exactly(8), _setting(
        "{} px, closed, filled, ellipse of its moments", lambda study: (study.scene.contact.gross_radius_px,))),
    Row("B16", "registration", "3 non-aligned points", "Images", (), _registration),
    Row("B17", "features", "700", "Images", exactly(700), _features),
    Row("B18", "tracking rejection", "bidirectional error > 1 px", "Images", exactly(1), _setting(
        "over {:g} px", lambda study: (study.scene.tracking.forward_backward_limit_px,))),
    Row("B19", "displacement", "", "Images", (), _displacement),
    Row("B20", "divergence", "", "Images", (), _divergence),
    Row("B21", "strains", "ε_xx = u_x + (u_x² + v_x²)/2, ε_xy = (u_y + v_x)/2", "Eq 1", (), _strains),
    Row("B22", "elastic constants", "E = 1 MPa, ν = 0.4", "Strain", exactly(1, 0.4), _setting(
        "E = {:g} MPa, ν = {:g}",
        lambda study: (study.scene.fields.young_modulus_mpa, study.scene.fields.poisson_ratio))),
    Row("B23", "energy density", "equation 2", "Eq 2", (), _energy_density),
    Row("B24", "depth", "2 mm", "Eq 3", exactly(2), _setting(
        "{:g} mm", lambda study: (study.scene.fields.depth_mm,))),
    Row("B25", "outer skin stiffness", "k_m = 2.5 kNm", "Model, Eq 4", exactly(2.5), _membrane),
    Row("B26", "subcutaneous stiffness", "k_t = 0.13 kNm", "Model", exactly(0.13), _tissue),
    Row("B27", "damping; response time", "ζ = 0.1; 10 ms", "Model", (*exactly(0.1), *rounded(10, digit=1)), _damping),
    Row("B28", "internal force", "F_i = -k_m (U_i-1 - 2 U_i + U_i+1) - k_t (U_i - U_b) - ζ dU_i/dt", "Eq 4", (),
        _internal_force),
    Row("B29", "motion", "B du/dt + K(u) u + F_ext = 0", "Eqs 5, 6", (), _motion),
    Row("B30", "friction law", "Dahl: σ0 = 500, n = 0.7", "Eq 7", exactly(500, 0.7), _setting(
        "σ0 = {:g} N/m, n = {:g}, F_c = μ p",
        lambda _: (float(_PAPER.friction_stiffness), float(_PAPER.friction_exponent)))),
    Row("B31", "time step, speed", "2.5 µs; 440 m/s", "Eq 8", exactly(2.5, 440), _speed),
    Row("B32", "spacing, elements", "Δx > 1.1 mm; 501", "Eq 8", ((1.1, math.inf), (501, 501)), _elements),
    Row("B33", "geometric compression", "10 % at δ = 3 mm", "Eqs 9, 10, S4C", rounded(10, digit=1), _compression),
    Row("B56", "deep model modulus", "E = 1.1 MPa", "Eq 12", exactly(1.1), _setting(
        "{:g} MPa", lambda _: (_default(viscoelastic_strain, "young_modulus") / 1e6,))),
    Row("B57", "cut-off", "E/η = 100 Hz", "Depth", rounded(100, digit=1), _cut_off),
    Row("B58", "receptor depths", "1.2 and 2 mm", "S10", exactly(1.2, 2), _setting(
        "{:g} and {:g} mm", lambda _: tuple(1000 * depth for depth in RECEPTOR_DEPTHS_M))),
    Row("B59", "deep stresses", "equation 11", "Eq 11", (), _deep_stresses),
    predicted("B60", "stress gain", "20 %", "S10D", rounded(20, digit=10), _gains(
        "peak of σ_z", lambda depth: depth.receptor_stress[1].min(-1))),
    predicted("B61", "strain gain", "20 % (text), almost 20 % (caption)", "S10F", rounded(20, digit=10), _gains(
        "compression 2 mm deep", lambda depth: -depth.strain_z[-1, :, len(depth.place) // 2])),
    Row("B62", "exclusion", "global displacement > 0.2 mm", "Observer", exactly(0.2), _exclusion),
)  # fmt: skip
