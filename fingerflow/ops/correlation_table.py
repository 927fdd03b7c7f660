"""Correlation tables: all that the steps of Lucas-Kanade need to know of an image, computed once a point.

The normal equation of a translation is b(y) = sum_w g(w) (S(y + w) - T(w)) = 0, with the template T and its gradient
g on
the window offsets w. S is a spline, S(y + w) = sum_k b(y - k) c[k + w], therefore

    b(y) = sum_k b(y - k) C[k] - sum_w g T,      C[k] = sum_w g(w) c[k + w].

C covers a few integer positions k around the prediction. Built once, it turns a step from an interpolation of the whole
window into (order + 1)^2 multiply-adds (idea: Rav-Acha & Peleg, "Lucas-Kanade without iterative warping", ICIP 2006).
"""

from typing import NamedTuple

import torch
from torch import Tensor

from fingerflow.ops.spline import spline_basis, spline_basis_derivative
from fingerflow.ops.windows import cut_windows

_GAUSS_NEWTON_STEPS = 6  # each leaves about a fifth of the error on ridge texture, from up to 2 px away
_MOST_GAIN = 8.0  # contrast of an image over that of the template
_NEWTON_NEAR = 0.05  # px, the step of Gauss and Newton below which Newton's own is taken
_LEAP = 4.0  # px that the first step may lead
_NEWTON_STEPS = 3  # with the exact Jacobian of the table: quadratic, so rounding is all that is left


class Match(NamedTuple):
    """Where a template was found.

    Attributes:
        points: (P, 2) px.
        inside: (P,) bool, False where the estimate ran to the edge of the table.
        step: (P,) px, length of the last step: what convergence is judged by.
    """

    points: Tensor
    inside: Tensor
    step: Tensor


def build_table(
    coefficients: Tensor, image_index: Tensor, center: Tensor, gradient: Tensor, level: Tensor, reach: int
) -> Tensor:
    """C[k] for the integer positions k within ``reach + 1`` px of ``center``.

    Args:
        coefficients: (B, 1, H, W).
        image_index: (P,) int64.
        center: (P, 2) int64 px.
        gradient: (P, 2, n, n), the template's.
        level: (P,) grey level taken off the image first, so that float32 sums do not cancel.
        reach: px that the estimate may move from ``center``.

    Returns:
        (P, 2, K, K) as (component, row, column), K = 2 reach + 3.
    """
    count, _, size, _ = gradient.shape
    positions = 2 * reach + 3
    patch = cut_windows(coefficients, image_index, center - size // 2 - reach - 1, size + positions - 1)
    patch = patch - level[:, None, None]
    # One product a point contracts the window's columns, for all its rows against all rows and shifts of the patch ...
    shifted = patch.unfold(2, positions, 1).transpose(1, 2)
    shifted = shifted.reshape(count, size, (size + positions - 1) * positions)
    product = gradient.transpose(1, 2).reshape(count, size * 2, size) @ shifted
    # ... then the rows that belong together are summed: C[ky, kx] = sum_r product[r, ky + r, kx].
    product = product.view(count, size, 2, (size + positions - 1) * positions)
    block = positions * positions
    table = product[:, 0, :, :block]
    for row in range(1, size):
        table = table + product[:, row, :, row * positions : row * positions + block]
    return table.view(count, 2, positions, positions)


def solve_table(
    table: Tensor, template_product: Tensor, inverse_hessian: Tensor, start: Tensor, order: int
) -> tuple[Tensor, Tensor]:
    """The root of b(y) = 0 in the table.

    Args:
        table: (P, 2, K, K).
        template_product: (P, 2), sum_w g T.
        inverse_hessian: (P, 2, 2), of sum_w g g^T.
        start: (P, 2) px from the table's centre.

    Returns:
        (P, 2) px from the table's centre, within its reach or where the first step led beyond it, and the length of
        the last step (P,).
    """
    positions = table.shape[-1]
    reach = (positions - 3) // 2
    taps = torch.arange(-reach - 1, reach + 2, device=table.device, dtype=table.dtype)
    shift = leap = start
    step = torch.zeros_like(start)
    for iteration in range(_GAUSS_NEWTON_STEPS + _NEWTON_STEPS):
        distance = shift[:, :, None] - taps
        weights = spline_basis(distance, order)
        rows = (table * weights[:, 0, None, None, :]).sum(-1)  # (P, 2, K), contracted over x
        residual = (rows * weights[:, 1, None, :]).sum(-1) - template_product
        if iteration == 0 or iteration >= _GAUSS_NEWTON_STEPS:
            slopes = spline_basis_derivative(distance, order)
            jacobian_x = ((table * slopes[:, 0, None, None, :]).sum(-1) * weights[:, 1, None, :]).sum(-1)
            jacobian_y = (rows * slopes[:, 1, None, :]).sum(-1)
        if iteration == 0:
            # An image of more contrast than the template has more slope: steps that do not know of it are too long.
            gain = (inverse_hessian[:, 0] * jacobian_x + inverse_hessian[:, 1] * jacobian_y).sum(-1) / 2
            gain = torch.where(gain > 1, gain, 1.0).clamp_max(_MOST_GAIN)
            inverse_hessian = inverse_hessian / gain[:, None, None]
        move = (inverse_hessian * residual[:, None, :]).sum(-1)
        if iteration == 0:
            leap = start - move.clamp(-_LEAP, _LEAP)
        if iteration >= _GAUSS_NEWTON_STEPS:
            # On the kinks of order 1 Newton may leap: never further than a pixel. Far from the root it leads away.
            newton = _solve_2x2(jacobian_x, jacobian_y, residual).nan_to_num(0.0, 0.0, 0.0).clamp(-1, 1)
            near = move.square().sum(-1, keepdim=True) < _NEWTON_NEAR**2
            move = torch.where(near, newton, move)
        moved = (shift - move).clamp(-reach, reach)
        step = shift - moved
        shift = moved
    # Where the first step leads out of the table, the next table begins there, not at this one's edge.
    leaps = ~(leap.abs() <= reach).all(-1)
    return torch.where(leaps[:, None], leap, shift), torch.where(leaps, _LEAP, step.square().sum(-1).sqrt())


def find_templates(
    coefficients: Tensor,
    image_index: Tensor,
    start: Tensor,
    gradient: Tensor,
    template: Tensor,
    inverse_hessian: Tensor,
    order: int,
    reach: int,
    rounds: int,
) -> Match:
    """Finds each template in its image near ``start``; a point that leaves its table gets a new one where it stands.

    Args:
        template: (P, n, n), and ``gradient`` (P, 2, n, n) its gradient, with the components to be solved for.
        start: (P, 2) px, finite.
        rounds: tables a point may use up.
    """
    level = template.mean((-1, -2))
    template_product = ((template - level[:, None, None])[:, None] * gradient).sum((-1, -2))

    def one_round(chosen: Tensor | slice, begin: Tensor) -> Match:
        center = begin.round()
        table = build_table(coefficients, image_index[chosen], center.long(), gradient[chosen], level[chosen], reach)
        shift, step = solve_table(table, template_product[chosen], inverse_hessian[chosen], begin - center, order)
        return Match(center + shift, (shift.abs() < reach).all(-1), step)

    match = one_round(slice(None), start)
    for _ in range(rounds - 1):
        left = torch.nonzero(~match.inside & match.points.isfinite().all(-1)).squeeze(-1)
        if left.numel() == 0:
            break
        again = one_round(left, match.points[left])
        match = Match(*(whole.index_copy(0, left, part) for whole, part in zip(match, again, strict=True)))
    return match


def _solve_2x2(column_x: Tensor, column_y: Tensor, right: Tensor) -> Tensor:
    """Solves [column_x column_y] s = right for (P, 2) tensors; non-finite where the matrix is singular."""
    determinant = column_x[:, 0] * column_y[:, 1] - column_x[:, 1] * column_y[:, 0]
    x = right[:, 0] * column_y[:, 1] - right[:, 1] * column_y[:, 0]
    y = column_x[:, 0] * right[:, 1] - column_x[:, 1] * right[:, 0]
    return torch.stack((x, y), dim=-1) / determinant[:, None]
