"""Medians of fields over ellipses of the deformed picture, where the fields are known by reference position."""

import math

import torch
from torch import Tensor

from fingerflow import kernels

_LEAST_STEPS, _MOST_STEPS = 8, 200  # positions a semi axis: a small ellipse gets enough, a wrong scale not all memory
_TURN = (5**0.5 - 1) / 2  # the golden section: its multiples, less their whole part, are spread evenly
_NEWTON_STEPS = 8  # at most; three or four do within a cell and across its border
_SETTLED = 1e-6  # of a step of the grid: a last step of this size leaves its square
_LEAST_RATIO = 0.1  # of areas after and before: less is no skin, but the edge of what is known
_LEAST_SHARE = 0.9  # of the area over which a field must be known for its median to mean anything


def area_medians(
    fields: Tensor,
    displacement: Tensor,
    origin: tuple[float, float],
    step: float,
    center: Tensor,
    semi_axes: Tensor,
    angle: Tensor,
    spacing: float,
) -> Tensor:
    """Medians (B, K), float64, of fields over an ellipse of the current picture.

    The median is that of the current area: over positions spread evenly in the ellipse, each led back to the reference
    position that the displacement brings there, where the fields are read bilinearly. Over reference positions it is
    another one, as what spreads covers more of the area than before.

    Args:
        fields: (B, K, R, C), floating, at the nodes of a square grid of reference positions; NaN where not known.
        displacement: (B, 2, R, C) in a length unit L, likewise. It must bring different places to different places.
        origin: x and y of the first node, L.
        step: from node to node, L.
        center: (B, 2) of the ellipses (x, y), L.
        semi_axes: (B, 2), L; the median is NaN where one is not positive.
        angle: (B,) of the first semi axis, from x towards y, rad.
        spacing: mean distance of the positions, L; a semi axis has 8 at least and 200 at most.

    NaN where the field is known over less than nine tenths of the ellipse. Carries no gradient.

    Raises:
        TypeError: fields or displacement are not floating.
        ValueError: shapes that do not belong together, fewer than 2 x 2 nodes, a step or spacing that is not positive.
    """
    _check_nodes(fields, displacement)
    _check_ellipses(len(fields), center, semi_axes, angle)
    _check_lengths(origin, step=step, spacing=spacing)
    with torch.no_grad():
        semi_axes = semi_axes.double()
        steps = (semi_axes / spacing).ceil().clamp(_LEAST_STEPS, _MOST_STEPS)
        towards = torch.stack((angle.double().cos(), angle.double().sin()), dim=-1)
        positions = (2 * steps + 1).prod(-1, keepdim=True)  # of the rectangle around the ellipse
        ellipses = torch.cat((center.double(), semi_axes, towards, positions), dim=-1)  # (B, 7), the last one odd
        ellipses = torch.where(
            ellipses.isfinite().all(-1, keepdim=True) & (semi_axes > 0).all(-1, keepdim=True), ellipses, torch.nan
        )
        if fields.dtype == displacement.dtype == torch.float32 and kernels.serve(fields, displacement, ellipses):
            return kernels.area_medians(
                fields,
                displacement,
                ellipses,
                turn=_TURN,
                origin=origin,
                step=step,
                newton_steps=_NEWTON_STEPS,
                settled=_SETTLED,
                least_ratio=_LEAST_RATIO,
                least_share=_LEAST_SHARE,
            )
        medians = [
            _medians_of_frame(*frame, origin, step)
            for frame in zip(fields.double(), displacement.double() / step, ellipses, strict=True)
        ]
        return torch.stack(medians) if medians else fields.new_empty(fields.shape[:2], dtype=torch.float64)


def _check_nodes(fields: Tensor, displacement: Tensor) -> None:
    for name, tensor, components in (("fields", fields, fields.shape[1:2]), ("displacement", displacement, (2,))):
        if not tensor.is_floating_point():
            raise TypeError(f"{name} must be floating, found {tensor.dtype}")
        if (
            fields.dim() != 4
            or min(fields.shape[2:]) < 2
            or tensor.shape != (len(fields), *components, *fields.shape[2:])
        ):
            raise ValueError(
                f"fields {tuple(fields.shape)} and displacement {tuple(displacement.shape)} must be (B, K, R, C) and "
                f"(B, 2, R, C) with at least 2 x 2 nodes"
            )


def _check_ellipses(batch: int, center: Tensor, semi_axes: Tensor, angle: Tensor) -> None:
    for name, tensor, shape in (("center", center, (2,)), ("semi_axes", semi_axes, (2,)), ("angle", angle, ())):
        if tensor.shape != (batch, *shape):
            raise ValueError(f"{name} must be {(batch, *shape)}, found {tuple(tensor.shape)}")


def _check_lengths(origin: tuple[float, float], **lengths: float) -> None:
    if len(origin) != 2:
        raise ValueError(f"origin must be x and y, found {origin}")
    for name, length in lengths.items():
        if not (math.isfinite(length) and length > 0):
            raise ValueError(f"{name} must be a positive length in the unit of the positions, found {length}")


def _medians_of_frame(
    fields: Tensor, displacement: Tensor, ellipse: Tensor, origin: tuple[float, float], step: float
) -> Tensor:
    """Medians (K,) of fields (K, R, C); displacement (2, R, C) in steps of the grid, ellipse (7,)."""
    nothing = fields.new_full((len(fields),), torch.nan)
    known = displacement.isfinite().all(0)
    if not (ellipse.isfinite().all() and known.any()):
        return nothing
    wanted = (_positions(ellipse) - ellipse.new_tensor(origin)[:, None]) / step
    reference, found = _led_back(wanted, displacement, known)
    values = torch.where(found & _within(reference, fields), _value_and_slopes(fields, reference)[0], torch.nan)
    enough = values.isfinite().sum(1) >= _LEAST_SHARE * values.shape[1]
    medians = [_median(field[field.isfinite()]) for field in values]
    return torch.where(enough, torch.stack(medians), nothing) if medians else nothing


def _positions(ellipse: Tensor) -> Tensor:
    """(2, P), a Fibonacci lattice about the centre: in whichever direction a field varies, it takes many values."""
    center, (major, minor), (cosine, sine) = ellipse[:6].view(3, 2)
    half = int(ellipse[6]) // 2
    number = torch.arange(-half, half + 1, dtype=ellipse.dtype, device=ellipse.device)
    right, turns = number / (half + 0.5), number * _TURN
    down = 2 * (turns - (turns + 0.5).floor())
    inside = right * right + down * down <= 1
    along, across = right[inside] * major, down[inside] * minor
    return center[:, None] + torch.stack((along * cosine - across * sine, along * sine + across * cosine))


def _led_back(wanted: Tensor, displacement: Tensor, known: Tensor) -> tuple[Tensor, Tensor]:
    """Places (2, P) that the displacement brings to the ones wanted, all in steps of the grid; whether found.

    Newton's method, from the mean displacement: skin may have moved by more than the contact is wide. Beyond the known
    nodes the displacement of a near one leads the search, so that it can cross what is not known.
    """
    leading = _extended(displacement, known)
    here = wanted - displacement[:, known].mean(1, keepdim=True)
    found = torch.zeros_like(here[0], dtype=torch.bool)
    for _ in range(_NEWTON_STEPS):
        moved, (xx, yx), (xy, yy) = _value_and_slopes(leading, here)
        missing = wanted - here - moved
        ratio = ((1 + xx) * (1 + yy) - xy * yx).clamp(min=_LEAST_RATIO)
        step = torch.stack(((1 + yy) * missing[0] - xy * missing[1], (1 + xx) * missing[1] - yx * missing[0])) / ratio
        here = torch.where(found, here, here + step)
        found = found | (step.abs() < _SETTLED).all(0)
        if found.all():
            break
    return here, found


def _extended(nodes: Tensor, known: Tensor) -> Tensor:
    """Nodes (2, R, C) that are not known get the value of the next known one in their row, or of the next such row."""
    rows, columns = known.shape
    row = _nearest(known.any(1)[None])[0]
    column = _nearest(known[row])
    return nodes[:, row[:, None].expand(rows, columns), column]


def _nearest(known: Tensor) -> Tensor:
    """Number (..., n) of the nearest known one, the first of two, in rows (..., n) that have one."""
    count = known.shape[-1]
    number = torch.arange(count, device=known.device).expand_as(known)
    before = torch.where(known, number, -2 * count).cummax(-1).values
    behind = torch.where(known, number, 3 * count).flip(-1).cummin(-1).values.flip(-1)
    return torch.where(number - before <= behind - number, before, behind)


def _within(places: Tensor, nodes: Tensor) -> Tensor:
    """(P,) whether places (2, P) lie on the grid of nodes (K, R, C)."""
    rows, columns = nodes.shape[1:]
    x, y = places
    return (x >= 0) & (y >= 0) & (x <= columns - 1) & (y <= rows - 1)


def _value_and_slopes(nodes: Tensor, places: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Bilinear value of nodes (K, R, C) and slopes along x and y, (K, P) each, at places (2, P), kept on the grid."""
    rows, columns = nodes.shape[1:]
    x, y = places.nan_to_num(0.0)
    x, y = x.clamp(0, columns - 1), y.clamp(0, rows - 1)
    column, row = x.long().clamp(max=columns - 2), y.long().clamp(max=rows - 2)
    x, y, node = x - column, y - row, row * columns + column
    flat = nodes.flatten(1)
    upper, lower = flat[:, node], flat[:, node + columns]
    upper_slope, lower_slope = flat[:, node + 1] - upper, flat[:, node + columns + 1] - lower
    upper, lower = upper + x * upper_slope, lower + x * lower_slope
    return upper + y * (lower - upper), upper_slope + y * (lower_slope - upper_slope), lower - upper


def _median(values: Tensor) -> Tensor:
    """Of (P,); NaN of none."""
    if not len(values):
        return values.new_tensor(torch.nan)
    ordered = values.sort().values
    return (ordered[(len(values) - 1) // 2] + ordered[len(values) // 2]) / 2
