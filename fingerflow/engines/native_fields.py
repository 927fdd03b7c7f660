"""Divergence, curl and strain at tracked points and medians over the contact, by the compiled library."""

import numpy as np

from fingerflow.engines.engine import Array, EnteredPoints, FrameEllipse, FrameFields
from fingerflow.kernels import field_limits as limits
from fingerflow.kernels.fields import area_medians, local_gradients

_UNKNOWN = np.float32(np.nan)


def fields_of_frames(
    reference: Array,
    displacement: Array,
    *,
    gauge_length: float,
    measure: str,
    ellipse: FrameEllipse,
    covariance: Array | None = None,
    entered: EnteredPoints | None = None,
) -> FrameFields:
    """Compute divergence, curl, strain and shear at N points in K frames, and medians over the apparent contact.

    The results are those of `graphs.FieldsGraph`. Args: reference: (1 or K, N, 2) float32 reference positions.
    displacement: (K, N, 2) float32 in the same unit; NaN where a point is not known. gauge_length: gauge length
    (virtual strain gauge): diameter of the support of a fit, in that unit. measure: strain measure, one of
    `field_limits.STRAIN_MEASURES`. ellipse: of the apparent contact. covariance: (K, N, 2, 2) float32 of the
    displacements; None for no standard deviations. entered: points that were advected into the contact. Their gradients
    count from their own entry, and they are left out of the fits of other points.
    """
    batch, count = displacement.shape[:2]
    rest = displacement
    if entered is not None:
        rest = np.where(entered.among[..., None], _UNKNOWN, displacement)
    gradient, spread = _point_gradients(reference, rest, gauge_length, covariance)
    if entered is not None:
        # A lost point has no gradient.
        own = entered.among & np.isfinite(displacement[..., 0] + displacement[..., 1])
        gradient[own] = entered.gradient[own]
        if spread is not None and entered.covariance is not None:
            spread[own] = entered.covariance[own]
    median, median_std, known_share = _area_medians(
        reference, displacement, covariance, ellipse, gauge_length, measure, entered
    )
    parts = np.ascontiguousarray(gradient.reshape(-1, 4).T)
    fields = _fields(parts, measure)
    shear = np.empty((batch, count, 2), np.float32)
    flat = shear.reshape(-1, 2)
    np.subtract(parts[0], parts[3], out=flat[:, 0])
    np.add(parts[1], parts[2], out=flat[:, 1])
    divergence_std = curl_std = None
    if spread is not None:
        divergence_std, curl_std = (one.reshape(batch, count) for one in _deviations(spread.reshape(-1, 4, 4)))
    return FrameFields(
        fields[0].reshape(batch, count),
        fields[1].reshape(batch, count),
        np.ascontiguousarray(fields[2:].T).reshape(batch, count, 3),
        shear,
        divergence_std,
        curl_std,
        median,
        median_std,
        known_share,
    )


def _point_gradients(
    reference: Array, displacement: Array, gauge_length: float, covariance: Array | None
) -> tuple[Array, Array | None]:
    """Fit displacement gradients (K, N, 2, 2) at N points in K frames over the gauge length; return them, and their
    covariance if that of the displacements is given, as `ops.fields.point_gradients`.
    """
    radius, noise = gauge_length / 2, None if covariance is None else covariance.reshape(*displacement.shape[:2], 4)
    fit = local_gradients(
        *(reference, displacement, reference, noise),
        radius=radius,
        least_spread=limits.MINIMUM_SPREAD * radius,
        minimum_points=limits.MINIMUM_POINTS,
    )
    gradient, spread = fit.gradient, fit.covariance
    lost = ~np.isfinite(displacement[..., 0] + displacement[..., 1])
    gradient[lost] = _UNKNOWN
    if spread is not None:
        spread[lost] = _UNKNOWN
    return gradient, spread


def _area_medians(
    reference: Array,
    displacement: Array,
    covariance: Array | None,
    ellipse: FrameEllipse,
    gauge_length: float,
    measure: str,
    entered: EnteredPoints | None,
) -> tuple[Array, Array | None, Array]:
    """Compute the medians of divergence, curl and strain over the contact ellipse of each of K frames, their standard
    deviations, and the share of the ellipse in which the fields are known.

    The results are those of `ops.fields.area_medians`.
    """
    batch = len(displacement)
    ellipses = np.empty((batch, 6), np.float32)
    ellipses[:, :2], ellipses[:, 2:4] = ellipse.center, ellipse.semi_axes
    np.cos(ellipse.angle, out=ellipses[:, 4])
    np.sin(ellipse.angle, out=ellipses[:, 5])
    among = fields = deviations = None
    if entered is not None:
        among = entered.among
        parts, fields = entered.gradient[among].reshape(-1, 4).T, np.full((*among.shape, 5), _UNKNOWN)
        fields[among] = _fields(parts, measure).T
        if covariance is not None:
            assert entered.covariance is not None, "known where that of the displacements is"
            deviations = np.full_like(fields, _UNKNOWN)
            deviations[among] = _field_deviations(parts, entered.covariance[among].reshape(-1, 4, 4), measure)
    return area_medians(
        *(reference, displacement, ellipses, covariance),
        *(among, fields, deviations),
        measure=limits.STRAIN_MEASURES.index(measure),
        radius=gauge_length / 2,
    )


def _fields(parts: Array, measure: str) -> Array:
    """Compute divergence, curl, exx, eyy and exy (5, P) at P points from gradients (4, P) with the rows du/dx, du/dy,
    dv/dx, dv/dy; `measure` names the definition of strain.
    """
    ux, uy, vx, vy = parts
    fields = np.empty((5, parts.shape[1]), np.float32)
    np.add(ux, vy, out=fields[0])
    np.subtract(vx, uy, out=fields[1])
    fields[2], fields[3] = ux, vy
    exy = np.add(uy, vx, out=fields[4])
    if measure == "green_lagrange":
        exy += ux * uy + vx * vy
    exy /= 2
    if measure != "infinitesimal":
        fields[2] += (ux * ux + vx * vx) / 2
        fields[3] += (uy * uy + vy * vy) / 2
    return fields


def _deviations(spread: Array) -> tuple[Array, Array]:
    """Return the standard deviations (P,) of divergence and of curl from covariances (P, 4, 4) of gradients."""
    return (
        _root(spread[:, 0, 0] + spread[:, 0, 3] + spread[:, 3, 0] + spread[:, 3, 3]),
        _root(spread[:, 2, 2] - spread[:, 2, 1] - spread[:, 1, 2] + spread[:, 1, 1]),
    )


def _field_deviations(parts: Array, spread: Array, measure: str) -> Array:
    """Return the standard deviations (P, 5) of divergence, curl and strain, by first-order propagation of the
    covariances `spread` (P, 4, 4) of the gradients.

    Gradients `parts` are (4, P); the results are those of `ops.field_std`.
    """
    ux, uy, vx, vy = parts
    direct = 0 if measure == "infinitesimal" else 1
    mixed = 1 if measure == "green_lagrange" else 0
    sensitivity = np.zeros((parts.shape[1], 5, 4), np.float32)
    divergence, curl, exx, eyy, exy = sensitivity.transpose(1, 2, 0)
    divergence[0] = divergence[3] = curl[2] = 1
    curl[1] = -1
    exx[0], exx[2] = 1 + direct * ux, direct * vx
    eyy[1], eyy[3] = direct * uy, 1 + direct * vy
    exy[:] = mixed * uy, 1 + mixed * ux, 1 + mixed * vy, mixed * vx
    exy /= 2
    return _root(((sensitivity @ spread) * sensitivity).sum(-1))


def _root(variance: Array) -> Array:
    """Return the square roots of variances; a variance that rounding made negative counts as zero."""
    result: Array = np.sqrt(np.maximum(variance, 0))
    return result
