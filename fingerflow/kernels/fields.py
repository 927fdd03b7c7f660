"""Kernels of fields at tracked points: local fits, medians over the contact area, strain of triangles."""

from collections.abc import Sequence
from typing import Generic, NamedTuple

import numpy as np

from fingerflow.kernels import field_limits as limits
from fingerflow.kernels.arrays import Array, empty, in_one_piece, kind, with_axes_reversed
from fingerflow.kernels.checks import check_axes, check_indices, check_like, checked
from fingerflow.kernels.library import entry, threads

_LATTICE = limits.lattice().astype(np.float32)


class FittedPlanes(NamedTuple, Generic[Array]):
    """Planes fitted locally to values of scattered points, at Q query positions: value, gradient and its covariance,
    number of points and distance of their centroid (`ops.fields.local_fit.LocalFit`).
    """

    value: Array
    gradient: Array
    covariance: Array | None
    point_count: Array
    centroid_offset: Array


def local_gradients(
    points: Array,
    values: Array,
    queries: Array,
    noise: Array | None,
    *,
    radius: float,
    least_spread: float,
    minimum_points: int,
) -> FittedPlanes[Array]:
    """Fit a plane, by weighted least squares, to the values (B, N, C) of the points within `radius` of each query
    position (B, Q, 2), and return value and gradient there, as `ops.fields.local_fit` up to rounding.

    Sums run in another order. `points` (B, N, 2), `values` (B, N, C), `queries` (B, Q, 2) and `noise` (B, N, 1 or C *
    C) share a dtype, float32 or float64. B is that of the results, or 1.

    Raises:
        TypeError, ValueError: wrong dtype, or inconsistent shapes.
    """
    given = {"points": points, "values": values, "queries": queries, "noise": noise}
    for name, tensor in given.items():
        if tensor is not None:
            check_axes(name, tensor, 3)
    (count, components), total, dtype = values.shape[1:], queries.shape[1], kind(points)
    batches = [tensor.shape[0] for tensor in given.values() if tensor is not None]
    batch = next((one for one in batches if one != 1), 1)
    if any(one not in (1, batch) for one in batches):
        raise ValueError(f"batches of {batches}: they are equal, or 1")
    columns = {"points": (2,), "values": (components,), "queries": (2,), "noise": (1, components**2)}
    for name, tensor in given.items():
        if tensor is None:
            continue
        rows = total if name == "queries" else count
        if kind(tensor) != dtype or dtype not in ("float32", "float64"):
            raise TypeError(f"{name} is {kind(tensor)}: all are float32 or float64")
        if tensor.shape[1] != rows or tensor.shape[2] not in columns[name]:
            raise ValueError(f"{name} has shape {tuple(tensor.shape)}: (B, {rows}, {columns[name]}) is needed")
    value, gradient = empty(points, dtype, batch, total, components), empty(points, dtype, batch, total, components, 2)
    covariance = None if noise is None else empty(points, dtype, batch, total, components, 2, components, 2)
    offset, counts = empty(points, dtype, batch, total), empty(points, "int64", batch, total)
    entry("local_gradients")(
        points=in_one_piece(points),
        values=in_one_piece(values),
        queries=in_one_piece(queries),
        noise=None if noise is None else in_one_piece(noise),
        points_batch=points.shape[0],
        values_batch=values.shape[0],
        queries_batch=queries.shape[0],
        noise_batch=0 if noise is None else noise.shape[0],
        batch=batch,
        point_count=count,
        query_count=total,
        components=components,
        noises=0 if noise is None else noise.shape[2],
        minimum_points=minimum_points,
        value=value,
        gradient=gradient,
        covariance=covariance,
        offset=offset,
        counts=counts,
        radius=radius,
        least_spread=least_spread,
        wide=dtype == "float64",
        threads=threads(),
    )
    return FittedPlanes(value, gradient, covariance, counts, offset)


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

    Raises:
        TypeError, ValueError: wrong dtype, or inconsistent shapes.
    """
    check_axes("reference", reference, 3)
    check_axes("displacement", displacement, 3)
    (batch, count, _), references = displacement.shape, reference.shape[0]
    check_like("reference", reference, "float32", (1 if references == 1 else batch, count, 2))
    check_like("displacement", displacement, "float32", (batch, count, 2))
    check_like("ellipses", ellipses, "float32", (batch, 6))
    if covariance is not None:
        check_like("covariance", covariance, "float32", (batch, count, 2, 2))
    if apart is not None:
        check_like("apart", apart, "bool", (batch, count))
        if apart_fields is None or (apart_std is None) != (covariance is None):
            raise ValueError("points apart have fields, and deviations where there is a covariance")
        for name, values in (("apart_fields", apart_fields), ("apart_std", apart_std)):
            if values is not None:
                check_like(name, values, "float32", (batch, count, 5))
    if measure not in (0, 1, 2):
        raise ValueError(f"measure {measure}: there are 0 to 2")
    medians, shares = empty(reference, "float32", batch, 5), empty(reference, "float32", batch)
    deviations = None if covariance is None else empty(reference, "float32", batch, 5)
    entry("medians_over_area")(
        reference=in_one_piece(reference),
        displacement=in_one_piece(displacement),
        ellipses=in_one_piece(ellipses),
        covariance=None if covariance is None else in_one_piece(covariance),
        lattice=_LATTICE,
        apart=None if apart is None else in_one_piece(apart),
        apart_fields=None if apart_fields is None else in_one_piece(apart_fields),
        apart_deviations=None if apart_std is None else in_one_piece(apart_std),
        medians=medians,
        deviations=deviations,
        shares=shares,
        batch=batch,
        reference_batch=references,
        point_count=count,
        positions=len(_LATTICE),
        measure=measure,
        minimum_points=limits.MINIMUM_POINTS,
        radius=radius,
        least_spread=limits.MINIMUM_SPREAD,
        farthest=2 * limits.FARTHEST_CENTROID,
        least_ratio=limits.LEAST_RATIO,
        least_share=limits.LEAST_SHARE,
        reach=limits.REACH,
        even=limits.EVEN,
        same_place=limits.SAME_PLACE,
        threads=threads(),
    )
    return medians, deviations, shares


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

    Raises:
        TypeError, ValueError: wrong dtype, inconsistent shapes, triangles of points out of range.
    """
    check_axes("displacement", displacement, 3)
    check_axes("triangles", triangles, 2)
    (batch, points, _), count = displacement.shape, triangles.shape[0]
    check_like("triangles", triangles, "int64", (count, 3))
    check_indices("triangles", triangles, points, "points")
    check_like("slopes", slopes, "float32", (count, 3, 2))
    if measure not in (0, 1, 2):
        raise ValueError(f"measure {measure}: there are 0 to 2")
    direct, between, shear = stiffness
    strain, strain_std = empty(triangles, "float32", batch, count, 3), empty(triangles, "float32", batch, count, 3)
    density, forces = empty(triangles, "float32", batch, count), empty(triangles, "float32", batch, points, 2)
    energy, own = empty(triangles, "float64", batch), empty(triangles, "float64", batch)
    entry("strain_of_triangles")(
        displacement=checked("displacement", displacement, "float32", (batch, points, 2)),
        covariance=checked("covariance", covariance, "float32", (batch, points, 2, 2)),
        in_contact=checked("in_contact", in_contact, "bool", (batch, count)),
        corners=with_axes_reversed(triangles, "int32"),
        slopes=with_axes_reversed(slopes, "float32"),
        products=checked("products", products, "float32", (3, 3, count)),
        areas=checked("areas", areas, "float32", (count,)),
        flat=checked("flat", flat, "float32", (count,)),
        strain=strain,
        strain_std=strain_std,
        density=density,
        energy=energy,
        forces=forces,
        own=own,
        batch=batch,
        point_count=points,
        triangle_count=count,
        measure=measure,
        direct=direct,
        between=between,
        shear=shear,
        threads=threads(),
    )
    return strain, strain_std, density, energy, forces, own
