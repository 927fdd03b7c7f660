"""Kernels of fields at points: local fits, medians over an area, strain of triangles."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from fingerflow.kernels.checks import check_indices, check_like, empty
from fingerflow.kernels.library import entry
from fingerflow.kernels.torch_op import torch_op

__all__ = [
    "FittedPlanes",
    "area_medians",
    "local_gradients",
    "triangle_strain",
]


class FittedPlanes(NamedTuple):
    """As `ops.local_fit.LocalFit` has them."""

    value: Tensor
    gradient: Tensor
    covariance: Tensor | None
    point_count: Tensor
    centroid_offset: Tensor


@torch_op()
def local_gradients(
    points: Tensor,
    values: Tensor,
    queries: Tensor,
    noise: Tensor | None,
    *,
    radius: float,
    least_spread: float,
    minimum_points: int,
) -> FittedPlanes:
    """Planes fitted as `ops.local_fit` has it, to rounding: sums run in another order.

    Points (B, N, 2), values (B, N, C), queries (B, Q, 2) and noise (B, N, 1 or C * C) share a dtype, float32 or
    float64; a batch is that of the results, or 1.

    Raises:
        TypeError, ValueError: another dtype, or shapes that do not belong together.
    """
    given = {"points": points, "values": values, "queries": queries, "noise": noise}
    (count, components), total, dtype = values.shape[1:], queries.shape[1], points.dtype
    batches = [tensor.shape[0] for tensor in given.values() if tensor is not None]
    batch = next((one for one in batches if one != 1), 1)
    if any(one not in (1, batch) for one in batches):
        raise ValueError(f"batches of {batches}: they are equal, or 1")
    columns = {"points": (2,), "values": (components,), "queries": (2,), "noise": (1, components**2)}
    for name, tensor in given.items():
        if tensor is None:
            continue
        rows = total if name == "queries" else count
        if tensor.dtype != dtype or dtype not in (torch.float32, torch.float64):
            raise TypeError(f"{name} is {tensor.dtype}: all are torch.float32 or torch.float64")
        if tensor.ndim != 3 or tensor.shape[1] != rows or tensor.shape[2] not in columns[name]:
            raise ValueError(f"{name} has shape {tuple(tensor.shape)}: (B, {rows}, {columns[name]}) is needed")
    value, gradient = empty(dtype, batch, total, components), empty(dtype, batch, total, components, 2)
    covariance = None if noise is None else empty(dtype, batch, total, components, 2, components, 2)
    offset, counts = empty(dtype, batch, total), empty(torch.int64, batch, total)
    entry("local_gradients")(
        points=points.contiguous(),
        values=values.contiguous(),
        queries=queries.contiguous(),
        noise=None if noise is None else noise.contiguous(),
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
        wide=dtype == torch.float64,
        threads=torch.get_num_threads(),
    )
    return FittedPlanes(value, gradient, covariance, counts, offset)


@torch_op()
def area_medians(
    reference: Tensor,
    displacement: Tensor,
    ellipses: Tensor,
    covariance: Tensor | None,
    apart: Tensor | None,
    apart_fields: Tensor | None,
    apart_std: Tensor | None,
    lattice: Tensor,
    *,
    measure: int,
    minimum_points: int,
    radius: float,
    least_spread: float,
    farthest: float,
    least_ratio: float,
    least_share: float,
    reach: float,
    even: float,
    same_place: float,
) -> tuple[Tensor, Tensor | None, Tensor]:
    """Medians (B, 5) over ellipses, their deviations and the share of positions (B,) in which they are known, as
    `ops.area_medians` has them to rounding; all float32.

    Reference (1 or B, N, 2), displacement (B, N, 2), ellipses (B, 6) of centre, semi axes, cosine and sine, covariance
    (B, N, 2, 2), lattice (P, 2); `apart` (B, N) bool with fields and deviations (B, N, 5), these where there is a
    covariance; measure 0 to 2, limits as in kernels/interface.h.

    Raises:
        TypeError, ValueError: another dtype, or shapes that do not belong together.
    """
    batch, count = displacement.shape[:2]
    references, positions = reference.shape[0], lattice.shape[0]
    check_like("reference", reference, torch.float32, (1 if references == 1 else batch, count, 2))
    check_like("displacement", displacement, torch.float32, (batch, count, 2))
    check_like("ellipses", ellipses, torch.float32, (batch, 6))
    check_like("lattice", lattice, torch.float32, (positions, 2))
    if covariance is not None:
        check_like("covariance", covariance, torch.float32, (batch, count, 2, 2))
    if apart is not None:
        check_like("apart", apart, torch.bool, (batch, count))
        if apart_fields is None or (apart_std is None) != (covariance is None):
            raise ValueError("points apart have fields, and deviations where there is a covariance")
        for name, values in (("apart_fields", apart_fields), ("apart_std", apart_std)):
            if values is not None:
                check_like(name, values, torch.float32, (batch, count, 5))
    if measure not in (0, 1, 2) or not positions:
        raise ValueError(f"measure {measure} of 0 to 2, {positions} positions")
    medians, shares = empty(torch.float32, batch, 5), empty(torch.float32, batch)
    deviations = None if covariance is None else empty(torch.float32, batch, 5)
    entry("medians_over_area")(
        reference=reference.contiguous(),
        displacement=displacement.contiguous(),
        ellipses=ellipses.contiguous(),
        covariance=None if covariance is None else covariance.contiguous(),
        lattice=lattice.contiguous(),
        apart=None if apart is None else apart.contiguous(),
        apart_fields=None if apart_fields is None else apart_fields.contiguous(),
        apart_deviations=None if apart_std is None else apart_std.contiguous(),
        medians=medians,
        deviations=deviations,
        shares=shares,
        batch=batch,
        reference_batch=references,
        point_count=count,
        positions=positions,
        measure=measure,
        minimum_points=minimum_points,
        radius=radius,
        least_spread=least_spread,
        farthest=farthest,
        least_ratio=least_ratio,
        least_share=least_share,
        reach=reach,
        even=even,
        same_place=same_place,
        threads=torch.get_num_threads(),
    )
    return medians, deviations, shares


@torch_op()
def triangle_strain(
    triangles: Tensor,
    slopes: Tensor,
    products: Tensor,
    areas: Tensor,
    flat: Tensor,
    displacement: Tensor,
    covariance: Tensor,
    in_contact: Tensor,
    *,
    measure: int,
    stiffness: Sequence[float],
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Strain (B, M, 3), its deviation, density (B, M) and energy (B,) float64, as `ops.triangle_strain` has them to
    rounding; the forces (B, N, 2) at the points, and the sum (B,) float64 of the squares of what the error of each adds
    to the energy.

    Triangles (M, 3) int64, slopes (M, 3, 2), products (3, 3, M) xx, xy, yy of the corners' slopes with those of what
    shares their errors, areas (M,) and flat (M,), displacement (B, N, 2), covariance (B, N, 2, 2), all float32;
    in_contact (B, M) bool; measure 0 to 2, stiffness of exx^2 + eyy^2, exx eyy and exy^2.

    Raises:
        TypeError, ValueError: another dtype, shapes that do not belong together, triangles of points out of range.
    """
    (batch, points), count = displacement.shape[:2], triangles.shape[0]
    check_like("triangles", triangles, torch.int64, (count, 3))
    check_indices("triangles", triangles, points, "points")
    check_like("slopes", slopes, torch.float32, (count, 3, 2))
    check_like("products", products, torch.float32, (3, 3, count))
    check_like("areas", areas, torch.float32, (count,))
    check_like("flat", flat, torch.float32, (count,))
    check_like("displacement", displacement, torch.float32, (batch, points, 2))
    check_like("covariance", covariance, torch.float32, (batch, points, 2, 2))
    check_like("in_contact", in_contact, torch.bool, (batch, count))
    if measure not in (0, 1, 2):
        raise ValueError(f"measure {measure}: there are 0 to 2")
    direct, between, shear = stiffness
    strain, strain_std = empty(torch.float32, batch, count, 3), empty(torch.float32, batch, count, 3)
    density, forces = empty(torch.float32, batch, count), empty(torch.float32, batch, points, 2)
    energy, own = empty(torch.float64, batch), empty(torch.float64, batch)
    entry("strain_of_triangles")(
        displacement=displacement.contiguous(),
        covariance=covariance.contiguous(),
        in_contact=in_contact.contiguous(),
        corners=triangles.T.to(torch.int32).contiguous(),
        slopes=slopes.permute(2, 1, 0).contiguous(),
        products=products.contiguous(),
        areas=areas.contiguous(),
        flat=flat.contiguous(),
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
        threads=torch.get_num_threads(),
    )
    return strain, strain_std, density, energy, forces, own
