"""Definitions of all result variables: name, dimensions, unit, meaning, equation and shown unit.

The data set, its files and tables, the records of a stream, figures, pages and the documentation use these entries.
Only the standard library is imported, because an exported bundle contains this file.
"""

from collections.abc import Iterable
from math import pi
from typing import Any

from fingerflow.schema.variable_record import (
    MICROJOULE,
    MICROMETRE,
    MILLISECOND,
    PERCENT,
    UM_PER_MM,
    UM_PER_MM_S,
    ShownUnit,
    Variable,
    with_deviation,
)

#: Symbols used in the equations.
SYMBOLS = """\
I is a pixel of a frame, I₀ of the empty glass, D without light; s mm per pixel of the contact view; x the position of a
point on the glass, X its reference position, u = x − X = (u, v) its displacement; u_x = ∂u/∂X and so on, from planes
fitted to u with weights (1 − (r/R)²)² within R, half of fields.gauge_length_mm; σ a standard deviation, Σ the
covariance of the inputs, propagated to first order. E, ν and h are fields.young_modulus_mpa, poisson_ratio and
depth_mm.
"""

FRAME, POINT, FRAME_POINT, TRIANGLE = ("frame",), ("point",), ("frame", "point"), ("frame", "triangle")
CELLS = ("frame", "cell_row", "cell_column")
RIDGE_MM = 0.45  # usual distance between ridges

_STD_EQUATION = "σ² = g Σ gᵀ, g the derivatives by what it is computed from"
_FIELD_STD_EQUATION = (
    "σ² = g Σ gᵀ + k² ⟨Δ_gauge²⟩ + late², Σ with the errors that points share as their windows overlap, Δ the change "
    "by twice the gauge length, less its noise, ⟨⟩ the mean over half of it, k² = 1/9 + (11 b)², b the gauge lengths "
    "to the centroid of the fit, late what the field of a point that moved in changes by in the deviation of its entry"
)
_MEDIAN_STD_EQUATION = (
    "σ² = g Σ gᵀ + Δ_gauge² + Δ_border² + late² + unknown²/3 + entered² + common², g the derivatives by what it is "
    "computed from, Δ_gauge the change by twice the gauge length, since onset a fifth of it, RMS over the elements, "
    "Δ_border the change by a border 0.014 mm further in, late the median gradient of v Δt/2 at "
    "onset, unknown half of the difference of quantiles (1 − κ)/(2κ) below and above, κ = field_coverage, entered that "
    "of fields √E points below and above, E points moved in, common on presses 0.64, "
    "0.21, 0.23, 0.23 and 0.11 µm/mm of divergence, curl, e_xx, e_yy and e_xy, as skin that touches looks different"
)
_AREA_STD_EQUATION = (
    "σ² = Σ w² σᵢ² + (q(½ + d) − q(½ − d))²/4, q the quantiles, w weights of the points near the median, "
    "d² = (rim/2)² + ((1 − κ)/(2κ))²/3 + √N/(6 N²), rim the share of a border 0.06 mm wide, κ the known share, N points"
)
_MEDIAN = "over the area of the gross contact"
_RATE_EQUATION = "slope of a parabola fitted over fields.rate_window_s (Savitzky & Golay 1964)"
_RATE_STD_EQUATION = "σ² = Σ w² σᵢ², w the weights of that slope, σᵢ the deviations of the frames"
_STRAIN_EQUATION = (
    "e_xx = u_x + (u_x² + v_x²)/2, e_yy = v_y + (u_y² + v_y²)/2, e_xy = (u_y + v_x)/2 + (u_x u_y + v_x v_y)/2; "
    "as_printed: e_xy without its products; infinitesimal: without any"
)
_RIGID_EQUATION = "|u − (R X + t)|, R and t the rotation and the shift of least squares"


def sparse_border_mm(real_area: Any, gross_area: Any) -> float:
    """Return by how much, mm, the border is uncertain as ridges cover little of the contact, from its real and gross
    areas (frames,) where it is largest: on presses of the skin chain it lay up to 0.18 mm too far out.
    """
    known = gross_area > 0
    share = (real_area[known] / gross_area[known])[gross_area[known].argmax()] if known.any() else 1
    return float(0.15 * min(max((0.23 - share) / 0.06, 0), 1))


def _small(semi_axes: Any) -> Any:
    """Return 1 for contacts of less than three ridges, about 1.5 mm^2, and 0 for larger ones, from the semi-axes
    (frames, 2), mm.
    """
    return 1 / (1 + (pi / 1.5 * semi_axes.prod(-1)) ** 4)


def _gross_area_std(semi_axes: Any, real_area: Any, gross_area: Any, threshold: Any) -> Any:
    """Return the standard deviation, mm^2, of the gross contact area in each frame, from the semi-axes (frames, 2), mm,
    of its ellipse, the real and gross contact areas and the contact threshold (frames,).

    Where there is no ellipse but a real area (frames,), a contact of a ridge or less is too small to be seen as one;
    where nothing is seen to touch, one may begin between two ridges, and before there is a threshold it may be larger.
    Each piece of the border, as long as a ridge spacing of 0.45 mm, errs by 0.06 mm on its own, as it does at onsets
    (`tracker.contact_border`). By 0.011 mm the border errs as a whole, measured on presses through real prints
    (docs/methods/contact.md).
    """
    around = pi * (2 * (semi_axes**2).sum(-1)) ** 0.5
    sparse = 4 * pi * gross_area * sparse_border_mm(real_area, gross_area) ** 2
    deviation = ((0.011**2 * around + 0.06**2 * RIDGE_MM) * around + 0.3**2 * _small(semi_axes) + sparse) ** 0.5
    unseen = (real_area == 0) & (threshold != threshold)
    for value, seen in ((0.15, real_area > 0), (0.04, real_area == 0), (0.2, unseen)):
        deviation[seen & (semi_axes != semi_axes).any(-1)] = value
    return deviation


def _real_area_std(real_area: Any, gross_area: Any, threshold: Any) -> Any:
    """Return the standard deviation, mm^2, of the real contact area (frames,), most of it shared by all frames.

    The edges of ridges are blurred, and the median takes their corners: measured on presses through real prints.
    Before there is a threshold, a contact is too small to be told from noise, and below 0.4 mm^2 of gross contact all
    of it may be noise in dim light.
    """
    noise = 0.1**2 * (threshold != threshold) + real_area**2 * (gross_area < 0.4)
    return (0.025**2 * real_area ** (4 / 3) + 0.01**2 + noise) ** 0.5


def _ratio(part: Any, whole: Any) -> Any:
    """Return the ratio of two areas, NaN where there is none."""
    return part / (whole / (whole > 0))


def _ratio_std(real_area: Any, real_std: Any, gross_area: Any, gross_std: Any) -> Any:
    """Return the standard deviation of the ratio of two areas with independent errors."""
    return (real_std**2 + (_ratio(real_area, gross_area) * gross_std) ** 2) ** 0.5 / gross_area


def _ellipse_std(lengths: Any, semi_axes: Any, *areas: Any) -> Any:
    """Return the standard deviation, mm, of the ellipse's centre or, given the `areas` that `sparse_border_mm` takes,
    of its semi-axes. On contacts of 3 to 60 mm^2 it does not depend on their size.
    """
    small, sparse = (0.12, sparse_border_mm(*areas)) if areas else (0.035, 0)
    return 0 * lengths + (0.028**2 + small**2 * _small(semi_axes)[..., None] + sparse**2) ** 0.5


def _angle_std(semi_axes: Any) -> Any:
    """Return the standard deviation, rad, of the angle of an ellipse, at most that of any angle, pi / sqrt(12)."""
    return 1 / (12 / pi**2 + ((semi_axes[..., 0] - semi_axes[..., 1]) / 0.03) ** 2) ** 0.5


def _shear_std(shear: Any, divergence_std: Any, curl_std: Any) -> Any:
    """Return the standard deviations (frames, points, 2) of shear along the axes and along the diagonals."""
    result = 0 * shear
    result[..., 0], result[..., 1] = divergence_std, curl_std
    return result


TIME = Variable("time", FRAME, "s", "time from the trigger, or from the first frame")

#: Names of the frame status values; only usable frames have results.
FRAME_STATUS = ("usable", "unreadable", "not_finite", "dark", "saturated", "repeated", "jumps_and_returns", "noise")
USABLE, UNREADABLE, NOT_FINITE, DARK, SATURATED, REPEATED, JUMPS, NOISE = range(len(FRAME_STATUS))
DARK_SHARE = 0.1  # a frame darker than this share of the empty glass's light is dark; a contact leaves half of it
SATURATED_SHARE = 0.5  # a frame with a larger share of blocks at the highest grey level is saturated

# fmt: off
FRAME_CHECK = (
    Variable("frame_status", FRAME, "1", "whether a frame is a picture of the trial; where it is not, results are NaN",
        "u1", equation="by light, saturation, copies and distance of each frame from those before and after",
        flags=FRAME_STATUS),)

LOADING = (
    Variable("normal_force", FRAME, "N", "normal force",
        equation="N(t), zero-phase low pass to half the frame rate, at the times of the frames", needs=("forces",)),
    Variable("tangential_force", FRAME, "N", "tangential force; its length where two components are given",
        equation="T(t), as the normal force", needs=("forces.tangential",)),
    Variable("tangential_direction", FRAME, "rad",
        "direction of the tangential force from the first component towards the second, of one channel 0 or pi by its "
        "sign; NaN below 0.05 N", equation="atan2(T_2, T_1); NaN where T < 0.05 N", needs=("forces.tangential",)),
    Variable("load_ratio", FRAME, "1",
        "friction ratio: tangential over normal force, T/N; NaN where the normal force is below 0.05 N",
        equation="T/N; NaN where N < 0.05 N", needs=("forces.tangential",), label="friction ratio T/N"),
    Variable("force_angle", FRAME, "rad",
        "angle between the force and the normal of the glass, atan(T/N); NaN where the normal force is below 0.05 N",
        equation="atan(T/N); NaN where N < 0.05 N", needs=("forces.tangential",)),
    Variable("actuator_position", FRAME, "mm", "position of the actuator that moves the finger or the glass",
        equation="as the normal force", needs=("forces.position",)),)

CONTACT = (
    Variable("contact_threshold", FRAME, "1", "relative intensity loss 1 - I/I0 that counts as contact",
        equation="Otsu's threshold of 1 − (I − D)/(I₀ − D), or contact.threshold"),
    *with_deviation(Variable("real_contact_area", FRAME, "mm2", "area of the micro-junctions",
        equation="s² Σ 1[1 − (I − D)/(I₀ − D) > contact_threshold], after a median of contact.median_px"),
        "σ² = (0.025 mm² (real_contact_area / mm²)^(2/3))² + (0.01 mm²)²: edges of ridges; 0.1 mm² if unseen, "
        "all of the area below 0.4 mm² of gross contact; (m − 3)² s²/0.45 mm² of it for a median of m > 3 px; recorded "
        "the real contact that lies beside the gross one where that is largest",
        ", shared by frames", formula=_real_area_std,
        of=("real_contact_area", "gross_contact_area", "contact_threshold")),
    *with_deviation(Variable("gross_contact_area", FRAME, "mm2",
        "apparent (gross) contact area, that of the region which the contact spans",
        equation="area where the contact, averaged over contact.gross_radius_px, is half as dense as near its rim"),
        "σ² = (b p)² + c² s p + d²/(1 + (π a₁ a₂ / 1.5 mm²)⁴), p = π √(2 (a₁² + a₂²)) the perimeter of the "
        "ellipse, b = 0.011 mm of the whole border, c = 0.06 mm of each piece s = 0.45 mm, a ridge spacing, d = 0.3 "
        "mm² below three ridges; 0.15 mm² without ellipse, 0.04 mm² without real area, 0.2 mm² without threshold; plus "
        "4 π gross faint_rim_mm², live 0.15 mm of it where ridges cover less than 17 % of the contact, 0 from 23 % on",
        ", by the ridge spacing", formula=_gross_area_std,
        of=("ellipse_semi_axes", "real_contact_area", "gross_contact_area", "contact_threshold")),
    *with_deviation(Variable("contact_area_ratio", FRAME, "1", "real over gross contact area",
        equation="real_contact_area / gross_contact_area", formula=_ratio,
        of=("real_contact_area", "gross_contact_area")), "√(σ²(real) + ratio² σ²(gross)) / gross_contact_area",
        formula=_ratio_std,
        of=("real_contact_area", "real_contact_area_std", "gross_contact_area", "gross_contact_area_std")),
    *with_deviation(Variable("ellipse_center", ("frame", "xy"), "mm", "centre of the gross contact on the glass",
        equation="c = ∫ x dA / A over the gross contact", label="centre of the ellipse"),
        "√((0.028 mm)² + (0.035 mm)²/(1 + (π a₁ a₂ / 1.5 mm²)⁴)), and faint_rim_mm", formula=_ellipse_std,
        of=("ellipse_center", "ellipse_semi_axes")),
    *with_deviation(Variable("ellipse_semi_axes", ("frame", "axis"), "mm", "semi-axes of the gross contact",
        equation="2 √λ, λ the eigenvalues of ∫ (x − c)(x − c)ᵀ dA / A", label="semi-axes of the ellipse"),
        "√((0.028 mm)² + (0.12 mm)²/(1 + (π a₁ a₂ / 1.5 mm²)⁴)), and faint_rim_mm", formula=_ellipse_std,
        of=("ellipse_semi_axes", "ellipse_semi_axes", "real_contact_area", "gross_contact_area")),
    *with_deviation(Variable("ellipse_angle", FRAME, "rad", "major axis of the gross contact, from x towards y",
        equation="½ atan2(2 m_xy, m_xx − m_yy), m = ∫ (x − c)(x − c)ᵀ dA / A", label="angle of the ellipse"),
        "1/√(12/π² + ((a₁ − a₂)/0.03 mm)²)", formula=_angle_std, of=("ellipse_semi_axes",)),
    Variable("gross_contact_region", CELLS, "1", "whether the gross contact covers a cell of the contact view", "?",
        equation="1 in cells of the gross contact", unasked=False),
)

#: Real contact area computed as in figure S3 A of Willemet et al. (2021).
PRINTED_CONTACT = (
    Variable("printed_contact_threshold", FRAME, "1",
        "Otsu's threshold of the intensity lost since the first instant of contact",
        equation="Otsu's threshold of I(first contact)/I₀ − I/I₀, median of 9 x 9 px", unasked=False,
        label="contact threshold as printed"),
    Variable("printed_real_contact_area", FRAME, "mm2",
        "real contact area by the steps that Willemet et al. 2021 print",
        equation="s² Σ 1[I(first contact)/I₀ − I/I₀ > printed_contact_threshold]", unasked=False,
        label="real contact area as printed"),
    Variable("printed_eroded_contact_area", FRAME, "mm2",
        "printed_real_contact_area eroded by a unit diamond, as in the code of that lab",
        equation="the same after erosion by a unit diamond", unasked=False,
        label="real contact area as printed, eroded"),)

#: Names of the values of `fingerflow.kernels.tracking_limits.TrackStatus`, which defines each.
TRACK_STATUS = (
    "tracked", "not_finite", "left_frame", "no_texture", "not_converged", "mismatch", "forward_backward", "uncertain",
    "off_neighbours", "frame_not_usable", "window_differs", "not_seeded_yet", "dust_in_window")
TRACKING = (
    Variable("position", ("frame", "point", "xy"), "mm", "position on the glass",
        equation="s (A (x, 1)), A = calibration.topography_to_contact, x = x_px corrected for calibration.distortion"),
    Variable("position_px", ("frame", "point", "xy"), "px", "position in the topographic view",
        equation="y with Σ_w g(w) (S(y + w) − T(w)) = 0, S the spline of the frame, T(w) = S_key(p + F⁻¹ w) the "
        "template, F its deformation, g the gradient of T without its parts along a constant and along T"),
    Variable("deformation_correction_px", ("frame", "point", "xy"), "px",
        "what the correction for the deformation of the skin has subtracted from the position at which a window was "
        "registered: their sum shows the mean displacement over the window", "f4",
        equation="D (F F₀⁻¹ − I) + (n² − 1)/24 ∇²u, D the lean of the template, F₀ its deformation, n px its side",
        unasked=False),
    Variable("position_std_px", FRAME_POINT, "px", "standard deviation of a component of the position", "f4",
        equation="√(tr C/2), C = H⁻¹ (Σ v vᵀ) H⁻¹ (σ²/a² + σ_key²), H = Σ_w g gᵀ, v the weight of a pixel in "
        "Σ g S, a the gain, σ² and σ_key² the noise of frame and key frame; plus δ² − 2 σ_δ², δ the shift to where "
        "most of a window in which dust stands out matches, σ_δ its error; plus (0.8 (n² − 1)/24)² Σ (∂²u/∂x∂x)², n "
        "the side of the window, over all second derivatives of both components, fitted over two windows"),
    Variable("position_noise_px", FRAME_POINT, "px",
        "part of position_std_px that is not due to displacement curved within the window", "f4",
        equation="√(tr C/2 + δ² − 2 σ_δ²), the terms of position_std_px by noise and dust",
        label="standard deviation of the position by image noise"),
    Variable("position_anisotropy", ("point", "xy"), "1",
        "anisotropy of the covariance of a position on the glass, of which position_std_px is the mean over directions",
        "f4", equation="(C_xx − C_yy, 2 C_xy)/(C_xx + C_yy), C that of position_std_px for the latest template"),
    Variable("subset_correlation", FRAME_POINT, "1",
        "correlation of the window (subset) of a point with that in which it was seeded, as of the last check, one in "
        "every eight frames", "f4",
        equation="ρ = Σ_w (I − Ī)(T − T̄) / √(Σ_w (I − Ī)² Σ_w (T − T̄)²), I the window deformed as the skin around it",
        shown_in=PERCENT),
    Variable("forward_backward_error", FRAME_POINT, "px", "distance after tracking forward and back", "f4",
        equation="|x − x′|, x′ after tracking forward and back (Kalal et al. 2010)", label="forward-backward error"),
    Variable("status", FRAME_POINT, "1", "why a point has a position, or none", "u1",
        equation="first test that a point has not passed", flags=TRACK_STATUS),
    Variable("in_contact", FRAME_POINT, "1", "whether the gross contact covers the point, or its last place", "?",
        equation="1[position inside the gross contact]"),
    Variable("tracked_share", FRAME, "1", "share of the points that are tracked",
        equation="mean of 1[status = 0] over the points", shown_in=PERCENT, label="points tracked"),
    Variable("window_differs_share", FRAME, "1",
        "share of the points that were followed to where their window differs from that in which they were seeded",
        equation="mean of 1[1 − ρ > max(0.05, 4 median(1 − ρ)) + 3 σ²/S], ρ the correlation of the windows "
        "then and now", shown_in=PERCENT, label="points rejected by verification"),
    Variable("forward_backward_median", FRAME, "px", "median forward-backward distance",
        equation="median of forward_backward_error over the tracked points", label="median forward-backward distance"),
)

ENTRY = ("never", "covered", "entered", "seeded_inside")
#: Reference instant of displacement in words. The attribute ``reference`` of a variable states it for its result.
SINCE = "of points in contact, since each touched the glass or since the chosen reference"
DISPLACEMENT = (
    Variable("onset_frame", POINT, "1", "first frame in which the contact comes to cover the point, -1 for never", "i4",
        equation="first frame of the first three in a row that the gross contact covers the point",
        label="frame of onset"),
    Variable("onset_frame_std", POINT, "1", "standard deviation of onset_frame, in frames",
        equation="σ² = 0.12 + 2.1 ((e v)²/(1 + d) + d³/(d + 1.4)), d = b v, v frames in which the border passes 1 mm "
        "of skin, b = 0.06 mm its deviation, e = 0.035 mm that of the ellipse; the factors are measured"),
    Variable("entry", POINT, "1",
        "how skin came into contact: the growing contact covered it, or it moved in over a border at rest. Fields of "
        "skin that moved in count since its own entry, F(t) F(entry)^-1 - I, those of a triangle since the last of its "
        "points touched. Skin whose point was seeded inside has no known entry, and no displacement", "u1",
        equation="covered where the border of the gross contact came over the point, entered where the point "
        "moved before over the glass by more than half of what both approached each other", flags=ENTRY,
        label="way into contact"),
    Variable("reference_position", ("point", "xy"), "mm",
        "position from which displacement counts (fields.reference): by default that at onset, when the border of the "
        "contact passed the point between two frames. Points that touch only briefly have their position then",
        equation="X = position in the frame from which displacement counts; by onset x₀ + (x₁ − x₀) d₀/(d₀ − d₁) "
        "between the frame before and that of onset, d the depth inside the ellipse of the gross contact"),
    Variable("displacement", ("frame", "point", "xy"), "mm", f"displacement {SINCE}", equation="u = x(t) − X",
        shown_in=MICROMETRE),
    Variable("displacement_std", FRAME_POINT, "mm", f"standard deviation of a component {SINCE}", "f4",
        equation="√(σ²(x(t)) + σ²(X) + tr(Σ of the time of onset)/2 + Φ(−d/b) (|u| min(1, b/c))²/2), the last of "
        "points at a depth d below 3 b in the first frame, b = 0.06 mm, that have moved inwards by c since",
        shown_in=MICROMETRE),
    *with_deviation(Variable("global_displacement_vector", ("frame", "xy"), "mm",
        f"median displacement {SINCE} {_MEDIAN}, by component",
        equation="(median u, median v) over the area, each part with the u of the nearest point within half of "
        "fields.gauge_length_mm; NaN where less than 0.85 is known", shown_in=MICROMETRE, label="median displacement"),
        _AREA_STD_EQUATION),
    *with_deviation(Variable("global_displacement", FRAME, "mm", "length of the median displacement",
        equation="|global_displacement_vector|", shown_in=MICROMETRE, label="median displacement"),
        "that of the component along global_displacement_vector"),
    Variable("printed_global_displacement", FRAME, "mm",
        "length of the median displacement over the points, as the paper has it: points crowd where skin has texture",
        equation="|(median u, median v)| over the points", shown_in=MICROMETRE, unasked=False),
)

_ALONE = (
    "by the errors of the points, the difference to medians by twice the gauge length, a border 0.014 mm off, the "
    "share that is not known, and points that moved in"
)
FIELDS = (
    *with_deviation(Variable("divergence", FRAME_POINT, "1",
        "stretch (+) or compression (-) of the skin since each point touched, or since the chosen reference", "f4",
        equation="u_x + v_y, the divergence of the displacement", shown_in=UM_PER_MM), _FIELD_STD_EQUATION),
    *with_deviation(Variable("curl", FRAME_POINT, "rad", f"curl of the displacement {SINCE}", "f4",
        equation="v_x − u_y", shown_in=UM_PER_MM), _FIELD_STD_EQUATION),
    *with_deviation(Variable("shear", ("frame", "point", "shear_component"), "1",
        "shear of the displacement: du/dx - dv/dy along the axes, du/dy + dv/dx along the diagonals; with the global "
        "displacement, divergence and curl the decomposition of Willemet et al. 2021, figure S6", "f4",
        equation="(u_x − v_y, u_y + v_x)", shown_in=UM_PER_MM, unasked=False),
        "(divergence_std, curl_std): u_x and v_y err alike, as do u_y and v_x", formula=_shear_std,
        of=("shear", "divergence_std", "curl_std")),
    Variable("rigid_residual", ("frame", "point", "xy"), "mm",
        "displacement that the best rigid motion of all points leaves: the usual sign of incipient slip", "f4",
        equation="u − (R X + t), R and t the rotation and the shift of least squares", shown_in=MICROMETRE,
        unasked=False, label="non-rigid motion"),
    Variable("rigid_residual_std", FRAME_POINT, "mm", "standard deviation of a component of rigid_residual", "f4",
        equation="√(σ²(u) + (median of σ(u) / 2)²), the last of the rigid motion, as points share errors",
        shown_in=MICROMETRE, unasked=False),
    *with_deviation(Variable("rigid_residual_median", FRAME, "mm",
        "median length of rigid_residual; NaN below 0.85 of field_coverage, and of fewer than 4 points",
        equation=f"median of {_RIGID_EQUATION}", shown_in=MICROMETRE, label="median non-rigid motion"),
        "√(min(b, b²/median)² + (1.4 c)² + (o/4)²), b 1.18 times the mean deviation of points by noise, c and "
        "o those by curvature within windows and by the time of onset"),
    Variable("field_coverage", FRAME, "1",
        "share of the gross contact in which divergence, curl and strain are known; medians below 0.85 are NaN",
        equation="share of 800 places evenly over the gross contact's ellipse at which a plane is fitted, or within a "
        "quarter of a gauge length of one", shown_in=PERCENT, label="contact with known fields"),
    *with_deviation(Variable("median_divergence", FRAME, "1", f"median divergence {_MEDIAN}",
        equation="median of div (u + 0.8 (u − v)), v as fitted, at 800 places of its ellipse", shown_in=UM_PER_MM),
        _MEDIAN_STD_EQUATION, f" {_ALONE}"),
    *with_deviation(Variable("median_divergence_rate", FRAME, "1/s", "rate of median_divergence",
        equation=_RATE_EQUATION, shown_in=UM_PER_MM_S), _RATE_STD_EQUATION),
    *with_deviation(Variable("median_curl", FRAME, "rad", f"median curl {_MEDIAN}",
        equation="that of median_divergence, for the curl", shown_in=UM_PER_MM), _MEDIAN_STD_EQUATION, f" {_ALONE}"),
    *with_deviation(Variable("median_strain", ("frame", "strain_component"), "1", f"median strain {_MEDIAN}",
        equation=f"median over 800 places evenly over the gross contact's ellipse of {_STRAIN_EQUATION}",
        shown_in=UM_PER_MM), _MEDIAN_STD_EQUATION, f" {_ALONE}"),
    *with_deviation(Variable("median_strain_rate", ("frame", "strain_component"), "1/s", "rate of median_strain",
        equation=_RATE_EQUATION, shown_in=UM_PER_MM_S), _RATE_STD_EQUATION),)

STRAIN = (
    Variable("triangles", ("triangle", "corner"), "1", "points at the corners of a triangle", "i4",
        equation="Delaunay triangulation of reference_position"),
    *with_deviation(Variable("strain", (*TRIANGLE, "strain_component"), "1", f"strain of a triangle {SINCE}", "f4",
        equation=f"{_STRAIN_EQUATION}; u_x ... of the triangle: linear between its corners", shown_in=UM_PER_MM),
        _STD_EQUATION),
    *with_deviation(Variable("strain_rate", (*TRIANGLE, "strain_component"), "1/s",
        "rate of the strain of a triangle (Delhaye et al. 2014)", "f4", equation=f"Ė, {_RATE_EQUATION} to the strain",
        shown_in=UM_PER_MM_S, unasked=False),
        "σ² = Σ w² n² + (dσ/dt)², w the weights of that slope, n² a twentieth of the variance of third "
        "differences of the strain of a triangle, of few with 4 as is usual for σ, its strain_std"),
    *with_deviation(Variable("principal_strains", (*TRIANGLE, "principal"), "1", "major and minor principal strain",
        "f4", equation="(e_xx + e_yy)/2 ± √(((e_xx − e_yy)/2)² + e_xy²)", shown_in=UM_PER_MM, unasked=False),
        "√(cos⁴φ σ²(e_xx) + sin⁴φ σ²(e_yy) + sin²2φ σ²(e_xy)), φ the direction of each"),
    *with_deviation(Variable("principal_angle", TRIANGLE, "rad",
        "direction of the major principal strain, from x towards y", "f4",
        equation="½ atan2(2 e_xy, e_xx − e_yy)", unasked=False),
        "1/√(12/π² + (e₁ − e₂)²/(sin²2φ (σ²(e_xx) + σ²(e_yy))/4 + cos²2φ σ²(e_xy))), at most π/√12, that of "
        "any angle"),
    *with_deviation(Variable("strain_energy_density", TRIANGLE, "mJ/mm3", "strain energy density, plane strain", "f4",
        equation="w = E(1−ν)/(2(1+ν)(1−2ν)) (e_xx² + e_yy²) + Eν/((1+ν)(1−2ν)) e_xx e_yy + E/(1+ν) e_xy²",
        shown_in=MICROJOULE),
        "σ² = g Σ gᵀ + tr(H Σ H Σ)/2 + w(σ)², g and H the first and second derivatives of w by the strain, "
        "Σ = diag(strain_std²), w(σ) what errors add on average"),
    *with_deviation(Variable("strain_energy", FRAME, "mJ", "strain energy of the whole contact, up to its border",
        equation="h ⟨∫_contact w dA⟩, the mean over smooth displacement fields that vanish at an advancing border, "
        "given the points; elsewhere strain_energy_between_points + h w̄ A, A the rest of the contact and w̄ the mean w "
        "beside it"),
        "√(σ²(points) + σ²(border) + (2U/u · 0.4 µm)² + U² q⁸), u the RMS displacement, of which 0.4 µm may "
        "be common to all points, q the window over the contact's width, with Δ to triangles where the border stopped; "
        "elsewhere √(strain_energy_between_points_std² + (h w̄ A/2)²), with 0.7 of what windows take if it is the share "
        "that smoothing over 2.5 of them takes again"),
    *with_deviation(Variable("strain_energy_between_points", FRAME, "mJ",
        "strain energy in triangles between points in contact, less that of noise",
        equation="h Σ_triangles in contact (w − w(Σ)) A, w(Σ) what errors add on average"),
        "√(σ²(points) + (h w̄ p b)² + (0.3 Δ)² + U² q⁸), w̄ the mean w half a gauge length from the border, p "
        "its length, b = 0.06 mm its deviation, Δ by how much strain_energy exceeds this sum and w̄ on the rest of the "
        "contact, where it is that of a field; Δ in place of 0.3 Δ where it is smaller; and with template 'previous' "
        "what is subtracted for noise, as errors of successive windows cancel in part",
        ", with that of the border's place"),
    *with_deviation(Variable("strain_energy_rate", FRAME, "mJ/s", "rate of strain_energy", equation=_RATE_EQUATION),
        _RATE_STD_EQUATION),
)

#: Strain and energy counted as in the lab's script for Willemet et al. (2021).
PRINTED_STRAIN = (
    Variable("printed_strain", ("frame", "strain_component"), "1",
        "median strain of the triangles in contact since the first frame with contact",
        equation="median over the triangles whose corners are in contact of the strain of x(t) − x(first contact)",
        shown_in=UM_PER_MM, unasked=False),
    Variable("printed_strain_energy", FRAME, "mJ",
        "strain energy of the triangles in contact since the first frame with contact",
        equation="h Σ_triangles in contact w A", unasked=False),
)

SLIP = (
    *with_deviation(Variable("stuck_area", FRAME, "mm2", "area of the contact whose skin has not slipped",
        equation="stuck_ratio gross_contact_area", label="stick area"),
        "√((gross_contact_area σ(d²))² + (d² σ(gross_contact_area))²)"),
    *with_deviation(Variable("stuck_ratio", FRAME, "1", "stuck area over gross contact area, d²",
        equation="d² = stuck share of the gross contact's area", label="stick ratio d²"),
        "√(4π d² σ² / gross_contact_area + 0.006²), σ the standard deviation of the border's position",
        ", most of it shared by all frames; NaN if the border was not found"),
    Variable("printed_stuck_ratio", FRAME, "1",
        "d² as Terekhov & Hayward 2011 print it: share of the contact whose skin has moved by less than 40 µm",
        equation="largest connected share of the gross contact with |u| < slip.stuck_mm",
        label="stick ratio d² as printed"),
    Variable("stuck_region", CELLS, "1", "whether the skin has not slipped", "?",
        equation="1 in cells of the largest connected part of the contact that has not slipped (slip.criterion)",
        label="stick region"),
    Variable("slip_coverage", FRAME, "1", "share of the gross contact that the windows of tracked points show",
        equation="share of the gross contact within half a window of a tracked point", shown_in=PERCENT,
        label="contact seen by the windows"),
    *(variable for half, where in (("leading", "towards which"), ("trailing", "from which")) for variable in
        with_deviation(Variable(f"{half}_area_rate", FRAME, "mm2/s", f"area of skin newly laid, over 150 ms, in the "
            f"half of the contact {where} the skin moves; negative where skin is peeled off (Delhaye et al. 2014)",
            equation="d/dt of the area of the half, relative to its skin; halves by the sum of all displacements"),
            "√(noise² + slope²), slope that of an error gross_contact_area_std / √2, whose correlation over a way s of "
            "the skin is exp(−(π s / (2 contact.gross_radius_px))²)")),
    Variable("skin_displacement", (*CELLS, "xy"), "mm",
        "displacement since the first frame, by dense flow, of the skin that lay in the cell in the first frame", "f4",
        equation="u by dense flow at the places of the first frame", shown_in=MICROMETRE, needs=("dense_flow_slip",)),
    Variable("dense_flow_difference", FRAME, "mm",
        "median over tracked points of the distance between their displacement and that by dense flow",
        equation="median over tracked points of |u − u by dense flow|", shown_in=MICROMETRE,
        needs=("dense_flow_slip",), label="difference to dense flow"),
    Variable("dense_flow_difference_95", FRAME, "mm",
        "95th percentile over tracked points of the distance between their displacement and that by dense flow",
        equation="95th percentile over tracked points of |u − u by dense flow|", shown_in=MICROMETRE,
        needs=("dense_flow_slip",), label="difference to dense flow, 95th percentile"),
)

#: Variables of streams only: the state of the stream, and fields that its graphs compute differently.
STREAM = (
    Variable("latency", FRAME, "s", "from the arrival of the frame to its result", "f4",
        equation="t(result) − t(frame)", shown_in=MILLISECOND),
    Variable("key_frame", FRAME, "1", "number of the frame with which this one was compared", "i8",
        equation="number of the frame that templates are from"),
    Variable("restart", FRAME, "1", "how often points had been seeded: points of two restarts are different points",
        "i4", equation="count of seedings", label="seedings of points"),
    Variable("slip_flag", FRAME, "1", "whether the rim of the contact has moved past its middle in three frames: slip",
        "?", equation="u = c + a z + b z̄ + e|z|² + d|z|²z; 1 where e along ū > 2 σ and > 2 √(|a + d|² + |b|²)",
        label="slip"),
    Variable("illumination_gain", FRAME, "1", "brightness of the contact view over that of the empty glass", "f4",
        equation="g = uppermost mode of (I − D)/(I₀ − D) over smooth blocks, the free glass"),
    *with_deviation(Variable("point_strain", (*FRAME_POINT, "strain_component"), "1",
        "Green-Lagrange strain around a point", "f4", equation=_STRAIN_EQUATION, shown_in=UM_PER_MM),
        "√(std(divergence)² + std(curl)²) / 2 of exx and eyy, that over √2 of exy"),
    Variable("entered", FRAME_POINT, "1",
        "whether a point came into contact by moving into it: divergence, curl and strain there count from its own "
        "entry, its neighbours from that moment", "?",
        equation="1 where neighbours that touch have moved by an eighth of the gauge length, in the median",
        label="moved into contact"),
)
# fmt: on


def by_name(*groups: Iterable[Variable]) -> dict[str, Variable]:
    """Return the variables in several groups as a mapping from name to definition."""
    return {variable.name: variable for group in groups for variable in group}


#: All variables of results and streams by name.
VARIABLES: dict[str, Variable] = by_name((TIME,), FRAME_CHECK, LOADING, CONTACT, PRINTED_CONTACT, TRACKING,
    DISPLACEMENT, FIELDS, STRAIN, PRINTED_STRAIN, SLIP, STREAM)  # fmt: skip


def shown_unit(name: str, units: str) -> ShownUnit:
    """Return the unit in which figures and tables show the variable `name`; a variable that is not defined here is
    shown in `units`.
    """
    return VARIABLES.get(name, Variable(name, (), units, "")).shown_unit
