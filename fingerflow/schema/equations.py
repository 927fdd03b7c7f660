"""Equations of the result variables in plain text, shown by `fingerflow outputs` and the documentation.

I is a pixel of a frame, I₀ of the empty glass, D without light; s mm per pixel of the contact view; x the position of a
point on the glass, X its reference position, u = x − X = (u, v) its displacement; u_x = ∂u/∂X and so on, from planes
fitted to u with weights (1 − (r/R)²)² within R, half of fields.gauge_length_mm; σ a standard deviation, Σ the
covariance of the inputs, propagated to first order. E, ν and h are fields.young_modulus_mpa, poisson_ratio and
depth_mm.
"""

_STD = "σ² = g Σ gᵀ, g the derivatives by what it is computed from"
_MEDIAN_STD = (
    "σ² = g Σ gᵀ + Δ_gauge² + Δ_border² + late² + unknown²/3 + entered², g the derivatives by what it is computed "
    "from, Δ the change by twice the gauge length and by an ellipse 0.06 mm smaller, less the noise in it, late the "
    "median gradient of v Δt/2 at onset, unknown half of the difference of quantiles (1 − κ)/(2κ) below and above, "
    "κ = field_coverage, entered that of fields √E points below and above, E points moved in"
)
_RATE = "slope of a parabola fitted over fields.rate_window_s (Savitzky & Golay 1964)"
_STRAIN = (
    "e_xx = u_x + (u_x² + v_x²)/2, e_yy = v_y + (u_y² + v_y²)/2, e_xy = (u_y + v_x)/2 + (u_x u_y + v_x v_y)/2; "
    "as_printed: e_xy without its products; infinitesimal: without any"
)
_RIGID = "|u − (R X + t)|, R and t the rotation and the shift of least squares"

EQUATIONS: dict[str, str] = {
    "frame_status": "by light, saturation and distance of each frame from those before and after",
    "normal_force": "N(t), zero-phase low pass to half the frame rate, at the times of the frames",
    "tangential_force": "T(t), as the normal force",
    "tangential_direction": "atan2(T_2, T_1); NaN where T < 0.05 N",
    "load_ratio": "T/N; NaN where N < 0.05 N",
    "force_angle": "atan(T/N); NaN where N < 0.05 N",
    "contact_threshold": "Otsu's threshold of 1 − (I − D)/(I₀ − D), or contact.threshold",
    "real_contact_area": "s² Σ 1[1 − (I − D)/(I₀ − D) > contact_threshold], after a median of contact.median_px",
    "gross_contact_area": "area where the contact, averaged over contact.gross_radius_px, is half as dense as inside",
    "contact_area_ratio": "real_contact_area / gross_contact_area",
    "ellipse_center": "c = ∫ x dA / A over the gross contact",
    "ellipse_semi_axes": "2 √λ, λ the eigenvalues of ∫ (x − c)(x − c)ᵀ dA / A",
    "ellipse_angle": "½ atan2(2 m_xy, m_xx − m_yy), m = ∫ (x − c)(x − c)ᵀ dA / A",
    "gross_contact_region": "1 in cells of the gross contact",
    "printed_contact_threshold": "Otsu's threshold of I(first contact)/I₀ − I/I₀, median of 9 x 9 px",
    "printed_real_contact_area": "s² Σ 1[I(first contact)/I₀ − I/I₀ > printed_contact_threshold]",
    "printed_eroded_contact_area": "the same after erosion by a unit diamond",
    "position": "s (A (x_px, 1)), A = calibration.topography_to_contact",
    "position_px": "y with Σ_w g(w) (S(y + w) − T(w)) = 0, S the spline of the frame, T(w) = S_key(p + F⁻¹ w) the "
    "template, F its deformation, g the gradient of T without its parts along a constant and along T",
    "position_std_px": "√(tr C/2), C = H⁻¹ (Σ v vᵀ) H⁻¹ (σ²/a² + σ_key²), H = Σ_w g gᵀ, v the weight of a pixel in "
    "Σ g S, a the gain, σ² and σ_key² the noise of frame and key frame",
    "forward_backward_error": "|x − x′|, x′ after tracking forward and back (Kalal et al. 2010)",
    "status": "first test that a point has not passed",
    "in_contact": "1[position inside the gross contact]",
    "tracked_share": "mean of 1[status = 0] over the points",
    "window_differs_share": (
        "mean of 1[1 − ρ > max(0.05, 4 median(1 − ρ)) + 3 σ²/S], ρ the correlation of the windows then and now"
    ),
    "forward_backward_median": "median of forward_backward_error over the tracked points",
    "entry": (
        "covered where the border of the gross contact came over the point, moved_in where the point moved before "
        "over the glass by more than half of what both approached each other"
    ),
    "onset_frame": "first frame of the first three in a row that the gross contact covers the point",
    "reference_position": (
        "X = position in the frame from which displacement counts; by onset x₀ + (x₁ − x₀) d₀/(d₀ − d₁) between the "
        "frame before and that of onset, d the depth inside the ellipse of the gross contact"
    ),
    "displacement": "u = x(t) − X",
    "displacement_std": "√(σ²(x(t)) + σ²(X) + tr(Σ of the time of onset)/2)",
    "global_displacement_vector": "(median u, median v) over the points",
    "global_displacement": "|global_displacement_vector|",
    "divergence": "u_x + v_y",
    "curl": "v_x − u_y",
    "shear": "(u_x − v_y, u_y + v_x)",
    "rigid_residual": "u − (R X + t), R and t the rotation and the shift of least squares",
    "rigid_residual_median": f"median of {_RIGID}",
    "divergence_std": _STD,
    "curl_std": _STD,
    "field_coverage": "share of 800 places evenly over the gross contact's ellipse at which a plane is fitted",
    "median_divergence": "median of the divergence at 800 places evenly over the gross contact's ellipse",
    "median_divergence_std": _MEDIAN_STD,
    "median_divergence_rate": _RATE,
    "median_curl": "median of the curl at 800 places evenly over the gross contact's ellipse",
    "median_curl_std": _MEDIAN_STD,
    "median_strain": f"median over 800 places evenly over the gross contact's ellipse of {_STRAIN}",
    "median_strain_std": _MEDIAN_STD,
    "median_strain_rate": _RATE,
    "triangles": "Delaunay triangulation of reference_position",
    "strain": f"{_STRAIN}; u_x ... of the triangle: linear between its corners",
    "strain_std": _STD,
    "principal_strains": "(e_xx + e_yy)/2 ± √(((e_xx − e_yy)/2)² + e_xy²)",
    "principal_angle": "½ atan2(2 e_xy, e_xx − e_yy)",
    "strain_energy_density": ("w = E(1−ν)/(2(1+ν)(1−2ν)) (e_xx² + e_yy²) + Eν/((1+ν)(1−2ν)) e_xx e_yy + E/(1+ν) e_xy²"),
    "strain_energy": "h Σ_triangles in contact (w − w(Σ)) A, w(Σ) what errors add on average",
    "strain_energy_std": (
        "√(σ²(points) + (h w̄ p b)²), w̄ the mean w within half a gauge length of the border, p its perimeter, "
        "b = 0.06 mm its deviation"
    ),
    "strain_energy_rate": _RATE,
    "stuck_area": "stuck_ratio gross_contact_area",
    "stuck_ratio": "d² = stuck share of the gross contact's area",
    "stuck_region": "1 in cells of the largest connected part of the contact that has not slipped (slip.criterion)",
    "slip_coverage": "share of the gross contact within half a window of a tracked point",
    "slip_annulus_area": "(1 − d²) gross_contact_area",
    "slip_direction": "atan2(mean v, mean u) over the points that have slipped",
    "slip_speed": "|mean of (x(t + 25 ms) − x(t − 25 ms))| / 50 ms over the points that have slipped",
    "incipient_slip": "√(∫ |u − (R X + t)|² dA / A) over the gross contact",
    "incipient_slip_irrotational": "√(∫ |∇φ|² dA / A), ∇²φ = div of the residual displacement",
    "incipient_slip_solenoidal": "√(∫ |∇×ψ|² dA / A), ∇²ψ = −curl of the residual displacement",
    "skin_displacement": "u by dense flow at the places of the first frame",
    "dense_flow_difference": "median over tracked points of |u − u by dense flow|",
    "dense_flow_difference_95": "95th percentile over tracked points of |u − u by dense flow|",
    "slip_ratio": "share of the markers in contact with |u − (R X + t)| > slip.stuck_mm",
    "contact_displacement": "mean u over the markers in contact",
    "gross_slip": "1 where Σ (u(t−1) − u(t))·ū/|ū| ≥ |ū|/3 on average and > 0 for 3/4 of the markers in contact",
    "latency": "t(result) − t(frame)",
    "key_frame": "number of the frame that templates are from",
    "restart": "count of choices of points",
    "slip_residual": "√(mean |u − (R X + t)|²) over the points in contact",
    "slip_flag": "1 where slip_residual > 2 σ in three frames",
    "light_gain": "g = uppermost mode of (I − D)/(I₀ − D) over smooth blocks, the free glass",
    "point_strain": _STRAIN,
    "moved_in": "1 where neighbours that touch have moved by an eighth of the gauge length, in the median",
}
