"""Compute the strain of triangles between tracked points, and the strain energy of triangles in contact.

The displacement gradient is constant in a triangle (Turner et al., J. Aeronaut. Sci. 23, 1956); strain and energy
density are those of Willemet et al. 2021 (`ops.fields.strain`). Compiled twin: `kernels/triangle_strain.cpp`.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.field_limits import STRAIN_MEASURES
from fingerflow.ops.fields.strain import energy_form, stiffness, strain_parts, stress_parts
from fingerflow.ops.fields.triangles import MINIMUM_QUALITY, triangle_areas, triangle_quality, triangle_slopes

# Correlation between the position errors of neighbouring points: (M, 3) of corners 0 and 1, 1 and 2, 2 and 0 of each
# triangle; indices (K, 2) int64 of all pairs of points with correlated errors, each pair once; (K,) of each pair.
SharedErrors = tuple[Tensor, ...]


class TriangleStrain(NamedTuple):
    """Strain of M triangles in B frames, and strain energy of each frame; NaN where unknown."""

    strain: Tensor  # (B, M, 3) strain exx, eyy, exy
    strain_std: Tensor  # (B, M, 3) standard deviation of the strain
    density: Tensor  # (B, M) energy density, mJ/mm^3
    energy: Tensor  # (B,) float64 energy, mJ per mm of depth, without the mean contribution of errors of the points
    energy_std: Tensor  # (B,) float64 standard deviation of the energy


def triangle_strain(
    reference: Tensor,
    triangles: Tensor,
    displacement: Tensor,
    covariance: Tensor,
    in_contact: Tensor,
    shared: SharedErrors | None = None,
    *,
    measure: str = "green_lagrange",
    young_modulus_mpa: float = 1.0,
    poisson_ratio: float = 0.4,
) -> TriangleStrain:
    """Compute the strain of triangles between tracked points from the displacements of the points, and the strain
    energy: the energy density integrated over the triangles in contact.

    The gradients are those of `triangle_gradients`. Frames share triangles and slopes. In the portable form they are
    the last axis and each quantity of a point or triangle is a row, so that a corner is fetched for all frames at once.

    Args:
        reference: (1, N, 2) reference positions, mm.
        triangles: (M, 3) indices of points, int64.
        displacement: (B, N, 2) mm, NaN where a point is not known.
        covariance: (B, N, 2, 2) mm^2 of the displacement.
        in_contact: (B, M) bool, triangles that count in the energy.
        shared: correlation of errors between points; none by default.
        measure: of strain, as in `green_lagrange`.
        young_modulus_mpa, poisson_ratio: of the solid, as in `strain_energy_density`.
    """
    solid = young_modulus_mpa, poisson_ratio
    corners = triangles.T.flatten()
    usable = triangle_quality(reference, triangles)[0] >= MINIMUM_QUALITY
    slopes = torch.where(usable[:, None, None], triangle_slopes(reference, triangles)[0], 0.0)
    # sum_ij x_i x_j C_ij with C_ij = r_ij (C_i + C_j) / 2 is a sum over corners, sum_i x_i (x_i + sum_j r_ij x_j) C_i.
    joint = slopes
    if shared is not None:
        after = shared[0].to(slopes.dtype)[..., None]  # correlation with the next corner
        joint = slopes + (slopes.roll(-1, 1) * after + slopes.roll(1, 1) * after.roll(1, 1))
    xx, yy = (slopes * joint).unbind(-1)
    xy = (slopes * joint.flip(-1)).mean(-1)
    products = torch.stack((xx, xy, yy)).mT  # (3, 3, M)
    along, down = slopes.permute(2, 1, 0)[..., None].unbind()  # (3, M, 1)
    flat = torch.where(usable, 0.0, torch.nan)[:, None].to(slopes.dtype)

    areas = triangle_areas(reference, triangles)
    compiled = kernels.serve(reference, displacement, covariance, in_contact)
    if compiled and displacement.dtype == torch.float32 and len(triangles):
        strain_of, strain_std, held, energy, forces, own = kernels.triangle_strain(
            *(triangles, slopes, products, areas[0], flat[:, 0], displacement, covariance, in_contact),
            measure=STRAIN_MEASURES.index(measure),
            stiffness=stiffness(*solid),
        )
        deviation = _energy_deviation(forces[..., 0].T, forces[..., 1].T, covariance, own, shared)
        return TriangleStrain(strain_of, strain_std, held, energy, deviation + 0 * energy)

    def take_corners(values: Tensor) -> Tensor:
        """Gather values (B, N) of points at the corners of the triangles, as (3, M, B)."""
        return values.T.contiguous().index_select(0, corners).unflatten(0, triangles.T.shape)

    def gradient(values: Tensor) -> tuple[Tensor, Tensor]:
        first, second, third = take_corners(values)
        second, third = second - first, third - first
        return along[1] * second + along[2] * third + flat, down[1] * second + down[2] * third + flat

    def sum_points(corner_values: Tensor) -> Tensor:
        """Return, for each of N points, the sum (N, B) of the contributions (3, M, B) of all triangle corners that lie
        at the point.
        """
        sums = corner_values.new_zeros(displacement.shape[1], len(displacement))
        return sums.index_add_(0, corners, corner_values.flatten(0, 1))

    (ux, uy), (vx, vy) = (gradient(moved) for moved in displacement.unbind(-1))
    exx, eyy, exy = strain = strain_parts(ux, uy, vx, vy, measure)
    density = energy_form(exx * exx, eyy * eyy, exy * exy, exx * eyy, *solid)
    shares = area_shares(in_contact, (density.abs() < torch.inf).T, areas).T
    counted = shares.nan_to_num(0.0)

    uu, uv, vv = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    uu, uv, vv = (take_corners(part) for part in (uu, uv, vv))  # (3, M, B) each, as the slopes' products
    xx, xy, yy = products[..., None]
    # The displacement (u, v) of a corner of slope s adds s_x u to exx, s_y v to eyy and (s_y u + s_x v) / 2 to exy.
    # These are the variances of exx, eyy and exy, and the covariance of exx and eyy, by the error at a corner. Skin
    # that is already stretched by some per cent makes them wrong by about as much, for all measures.
    errors = xx * uu, yy * vv, (yy * uu + 2 * xy * uv + xx * vv) / 4, xy * uv
    added = counted * energy_form(*errors, *solid).nan_to_num(0.0)
    energy = (shares * density.nan_to_num(0.0)).sum(0, dtype=torch.float64) - added.sum((0, 1), dtype=torch.float64)
    energy = torch.where(counted.any(0), energy, torch.nan)  # a sum over no triangles would be 0
    sxx, syy, sxy = (counted * part.nan_to_num(0.0) for part in stress_parts(*strain, *solid))
    x, y, own = (sum_points(part) for part in (sxx * along + sxy * down, syy * down + sxy * along, added))
    deviations = [error.sum(0).clamp_min(0).sqrt() + 0 * part for error, part in zip(errors[:3], strain, strict=True)]
    return TriangleStrain(
        torch.stack(strain).permute(2, 1, 0),
        torch.stack(deviations).permute(2, 1, 0),
        density.T,
        energy,
        _energy_deviation(x, y, covariance, (own * own).sum(0, dtype=torch.float64), shared) + 0 * energy,
    )


def _energy_deviation(x: Tensor, y: Tensor, covariance: Tensor, alone: Tensor, shared: SharedErrors | None) -> Tensor:
    """Return the standard deviation (B,) of the strain energy due to displacement errors of the points, from their
    `covariance` and the elastic forces x, y (N, B) at the points (derivatives of the energy).

    The variance is the sum of two parts:
    - To first order: that of the errors times the forces x, y (N, B) at the points.
    - That of the energy that the errors themselves add. For a point it is the square of the mean of that energy, as a
      displacement has two components. `alone` (B,) is the sum over points; the stiff coupling between neighbours adds a
      sixth.

    The measured forces are noisy too, which adds twice the second part to the first on average.
    """
    uu, uv, vv = (covariance[..., i, j].nan_to_num(0.0).T for i, j in ((0, 0), (0, 1), (1, 1)))
    linear = (x * x * uu + 2 * x * y * uv + y * y * vv).sum(0, dtype=torch.float64)
    if shared is not None:
        forces = torch.stack((x, y)) * ((uu + vv) / 2).clamp_min(0).sqrt()
        _, pairs, correlation = shared
        # `device` is given, as torch would otherwise use the default device and not that of the tensors.
        neighbours = torch.sparse_coo_tensor(
            pairs.T, correlation.to(x.dtype), (len(x), len(x)), device=x.device, check_invariants=True
        )
        of_others = torch.stack([torch.sparse.mm(neighbours, force) for force in forces])
        linear = linear + 2 * (forces * of_others).sum((0, 1), dtype=torch.float64)
    of_itself = 7 / 6 * alone
    return torch.maximum(linear - of_itself, of_itself).sqrt()


def area_shares(in_contact: Tensor, valid: Tensor, areas: Tensor) -> Tensor:
    """Return the area (B, M) with which each triangle enters an integral over the triangles in contact: triangles of
    `valid` strain get a larger area, to stand also for unknown ones.

    Triangles that are not `valid` are represented by the mean of the others. NaN where the known ones cover less than
    half of the area, or where no triangle is in contact.
    """
    areas = areas.nan_to_num(0.0)
    counted = (in_contact & valid) * areas
    whole, seen = (in_contact * areas).sum(1, keepdim=True), counted.sum(1, keepdim=True)
    return counted * torch.where((seen > 0) & (seen >= whole / 2), whole / seen, torch.nan)
