"""Kernels of fields at tracked points: local fits, medians over the contact area, strain of triangles.

What does not fit the declaration of a kernel raises TypeError (wrong dtype) or ValueError.
"""

from collections.abc import Sequence

import numpy as np

from fingerflow.kernels import field_limits as limits
from fingerflow.kernels.arrays import Array, with_axes_reversed
from fingerflow.kernels.library import compiled
from fingerflow.kernels.result_records import EnteredPoints, FrameEllipse, FrameFields, LocalFit

_OVER_AREA = {  # arguments of medians over an area
    "lattice": limits.lattice().astype(np.float32),
    **{"minimum_points": limits.MINIMUM_POINTS, "least_spread": limits.MINIMUM_SPREAD, "reach": limits.REACH},
    **{"farthest": 2 * limits.FARTHEST_CENTROID, "least_ratio": limits.LEAST_RATIO, "even": limits.EVEN},
    **{"same_place": limits.SAME_PLACE, "least_share": limits.LEAST_SHARE},
}


def local_gradients(
    points: Array,
    values: Array,
    queries: Array,
    noise: Array | None,
    *,
    radius: float,
    minimum_points: int = limits.MINIMUM_POINTS,
) -> LocalFit:
    """Fit a plane, by weighted least squares, to the values (B, N, C) of the points within `radius` of each query
    position (B, Q, 2), and return value and gradient there, as `ops.fields.local_fit` up to rounding.

    Sums run in another order. `points` (B, N, 2), `values` (B, N, C), `queries` (B, Q, 2) and `noise` (B, N, 1 or C *
    C) share a dtype, float32 or float64. B is that of the results, or 1.
    """
    batch = 1
    for array in (points, values, queries) if noise is None else (points, values, queries, noise):
        batch = array.shape[0] if batch == 1 else batch
    fit = compiled("local_gradients")(
        points=points,
        values=values,
        queries=queries,
        noise=noise,
        batch=batch,
        minimum_points=minimum_points,
        radius=radius,
        least_spread=limits.MINIMUM_SPREAD * radius,
    )
    return LocalFit(*fit)


def area_medians(
    reference: Array,
    displacement: Array,
    ellipses: Array,
    covariance: Array | None,
    apart: Array | None,
    apart_fields: Array | None,
    apart_std: Array | None,
    *,
    measure: int,
    radius: float,
) -> tuple[Array, Array | None, Array]:
    """Compute the medians of divergence, curl and the strains over the area of contact ellipses from displacements of N
    points, as `ops.fields.area_medians` up to rounding.

    The results are medians (B, 5), their standard deviations (B, 5), None without `covariance`, and the share (B,) of
    positions in an ellipse where the fields are known.

    Args:
        reference, displacement: (1 or B, N, 2) and (B, N, 2).
        ellipses: (B, 6), centre, semi axes, cosine and sine of the angle.
        covariance: (B, N, 2, 2) of the displacements, or None.
        apart: (B, N) bool, points with fields of their own, or None.
        apart_fields, apart_std: (B, N, 5) of these points; the deviations if there is a covariance.
        measure: index into `field_limits.STRAIN_MEASURES`.
        radius: of the support of a fit.
    """
    if apart is not None and (apart_fields is None or (apart_std is None) != (covariance is None)):
        raise ValueError("points apart have fields, and deviations where there is a covariance")
    return compiled("medians_over_area")(
        reference=reference, displacement=displacement, ellipses=ellipses, covariance=covariance, apart=apart,
        apart_fields=apart_fields, apart_deviations=apart_std, measure=measure, radius=radius, **_OVER_AREA,
    )  # fmt: skip


def fields_of_frames(
    reference: Array,
    displacement: Array,
    ellipse: FrameEllipse,
    covariance: Array | None,
    entered: EnteredPoints | None,
    *,
    measure: int,
    radius: float,
) -> FrameFields:
    """Compute the fields of N points in K frames and their medians over the contact, as `graphs.FieldsGraph` up to
    rounding.

    Args:
        reference, displacement: (N, 2) and (K, N, 2).
        ellipse: of the contact in each frame.
        covariance: (K, N, 2, 2) of the displacements, or None.
        entered: points with gradients of their own, or None.
        measure: index into `field_limits.STRAIN_MEASURES`.
        radius: of the support of a fit.
    """
    among, gradient, spread = (None, None, None) if entered is None else entered
    if among is not None and covariance is not None and spread is None:
        raise ValueError("points that entered have deviations where there is a covariance")
    center, semi_axes, angle = [part.astype(np.float32, copy=False) for part in ellipse]
    return FrameFields(*compiled("fields_of_frames")(
        reference=reference, displacement=displacement, covariance=covariance, center=center, semi_axes=semi_axes,
        angle=angle, apart=among, apart_gradient=gradient, apart_covariance=spread, measure=measure, radius=radius,
        sharpened=limits.SHARPENED, sharpened_noise=limits.SHARPENED_NOISE, **_OVER_AREA,
    ))  # fmt: skip


def triangle_strain(
    triangles: Array,
    slopes: Array,
    products: Array,
    areas: Array,
    flat: Array,
    displacement: Array,
    covariance: Array,
    in_contact: Array,
    *,
    measure: int,
    stiffness: Sequence[float],
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Compute strain and elastic strain energy of the M triangles of a mesh from the displacements (B, N, 2) of its
    points, as `ops.fields.triangle_strain` up to rounding.

    The results are strain (B, M, 3), its standard deviation, energy density (B, M), energy (B,) float64, forces
    (B, N, 2) at the points, and the sum (B,) float64 of the squares of what the error of each point adds to the energy.

    `triangles` is (M, 3) int64 and `in_contact` (B, M) bool. All others are float32: `slopes` (M, 3, 2), `products`
    (3, 3, M) xx, xy, yy of the corners' slopes with those of what shares their errors, `areas` (M,), `flat` (M,),
    `displacement` (B, N, 2), `covariance` (B, N, 2, 2). `measure` is 0 to 2; `stiffness` has the factors of
    exx^2 + eyy^2, exx eyy and exy^2.
    """
    return compiled("strain_of_triangles")(
        **{"displacement": displacement, "covariance": covariance, "in_contact": in_contact},
        **{"products": products, "areas": areas, "flat": flat, "measure": measure},
        **dict(zip(("direct", "between", "shear"), stiffness, strict=True)),
        corners=with_axes_reversed(triangles, "int32"),
        slopes=with_axes_reversed(slopes, "float32"),
    )
