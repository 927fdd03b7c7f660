"""Points of the key frame found in a frame: correlation tables, a fixed number of steps, and the way back."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.ops.tracking import CONVERGED, GRADIENT_NOISE, TEXTURE_TO_NOISE, VALUE_NOISE, TrackStatus
from fingerflow.stream.fields import components_first
from fingerflow.stream.finite import finite
from fingerflow.stream.key import Templates
from fingerflow.stream.spline_features import feature_slopes, features
from fingerflow.stream.sums import sum_first, sum_rows
from fingerflow.stream.windows import Windows

_GAUSS_NEWTON_STEPS = 2  # safe far from the root: each leaves a fifth of the error
_NEWTON_STEPS = 2  # by the slopes at the first of them: 0.04 px become 4e-4 and 1e-5
_BACK_STEPS = 2  # after a linear one
_MISMATCH_LIMIT = 0.05
_VALUE_NOISE, _GRADIENT_NOISE = VALUE_NOISE[3], GRADIENT_NOISE[3]
_TINY = 1e-20


class StreamTracks(NamedTuple):
    """As `ops.Tracks`: points (B, N, 2) px and covariance (B, N, 2, 2) px^2, NaN where lost; error (B, N) px; status
    (B, N) uint8."""

    points: Tensor
    error: Tensor
    covariance: Tensor
    status: Tensor


class TrackStep(nn.Module):
    """`ops.track_points` from a key frame to a frame in which points lie near their predictions.

    Args:
        window: odd side, px.
        reach: px from the whole pixel nearest to a prediction within which its point is found.
        exact_return: find every point again in the key frame from where it was found, by the key frame's slopes and
            bends at the point: to second order, within 6e-5 px of the search on a press, where points return to
            0.03 px; further off it is coarser, by some percent of a pixel near the limit. Otherwise one Gauss-Newton
            step from the start tells how far it would end from there: the same to first order.
        forward_backward_limit: px beyond which a point counts as lost.
    """

    turn: Tensor

    def __init__(
        self,
        window: int = 21,
        reach: int = 1,
        exact_return: bool = True,
        forward_backward_limit: float = 1.0,
        precision: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        self.windows = Windows(window, reach, precision)
        self.exact_return = exact_return
        self.forward_backward_limit = forward_backward_limit
        # (u, v) to (v, -u): the product with it is the cross product.
        self.register_buffer("turn", torch.tensor([[0.0, 1.0], [-1.0, 0.0]], dtype=precision))

    def forward(self, topography_view: Tensor, prediction: Tensor, templates: Templates) -> StreamTracks:
        """(B, 1, H, W) view, (B, N, 2) px prediction; templates of `KeyStep`."""
        windows, samples, shape = self.windows, self.windows.size**2, prediction.shape[:2]
        # Components before points from here on: runtimes are slow where the last axis is short.
        start = components_first(templates.template_start).transpose(0, 1).flatten(1)  # (2, P)
        guess = components_first(prediction.to(windows.precision)).transpose(0, 1).flatten(1)
        given = finite(sum_first(start + guess))
        guess = torch.where(finite(guess), guess, 0.0)
        center = guess.round()
        along_y = windows.along_y(windows.patches(topography_view, center))
        table = along_y @ templates.template_gradients.flatten(0, 1)
        products = templates.template_products.transpose(0, 1).flatten(1)  # (6, P)
        xx, xy, yy, tt = products[0], products[1], products[2], products[5]
        determinant = xx * yy - xy * xy
        regular = determinant > _TINY
        inverse = torch.stack((yy, -xy, -xy, xx)) / torch.where(regular, determinant, 1.0)  # (4, P)
        preconditioner = inverse.reshape(2, 2, -1)
        shift, step = self._solve(table.permute(1, 2, 0), products[3:5], preconditioner, guess - center)
        converged = (shift.abs().amax(0) < windows.reach) & (step < CONVERGED)  # (P)
        found = center + shift

        values, slopes = (make(shift, windows.reach) for make in (features, feature_slopes))
        # Values and slopes along y in one product, which reads `along_y` once.
        lines = windows.at_y(along_y, torch.stack((values[:, 1], slopes[:, 1])).permute(2, 0, 1))
        across = windows.at_x(values[:, 0].T)
        matched, by_y = ((lines.flatten(1, 2) @ across).unflatten(1, (2, -1))).flatten(2).unbind(1)
        by_x = (lines[:, 0] @ windows.at_x(slopes[:, 0].T)).flatten(1)
        template = templates.template_values.flatten(0, 1)
        level, noise = templates.template_level.flatten(), templates.template_noise.flatten()
        difference = matched - template
        squares, other = (difference * difference).sum(1), difference.sum(1)
        along = (template * difference).sum(1) - level * other  # of the template less its level
        # Sums of squares and products of the two windows, both less the template's level, from their difference.
        own, together = squares + 2 * along + tt, along + tt
        noise_energy = noise * (samples * _VALUE_NOISE)
        energy = (tt - noise_energy).clamp_min(0) * (own - other * other / samples - noise_energy).clamp_min(0)
        explained = together * together.clamp_min(0)
        rounding = 0.0 if topography_view.is_floating_point() else 1 / 12
        variance = (squares / ((samples - 4) * 2 * _VALUE_NOISE)).clamp_min(rounding)

        rest = torch.stack([(slope * difference).sum(1) for slope in (by_x, by_y)])  # (2, P)
        if self.exact_return:
            bends = templates.template_slopes.flatten(0, 1)
            terms = torch.stack([(bends @ slope[:, :, None]).squeeze(2).T for slope in (by_x, by_y)], dim=1)
            back, back_step = self._way_back(terms, rest)
            returned = (back.abs().amax(0) < windows.reach) & (back_step < CONVERGED) & converged
        else:
            back = sum_rows(preconditioner * rest)
            returned = converged
        error = _length(back)

        mean, half = (xx + yy) / 2, (xx - yy) / 2
        spread = (half * half + xy * xy).sqrt()
        floor = noise.clamp_min(rounding) * (TEXTURE_TO_NOISE * samples * _GRADIENT_NOISE)
        textured = regular & (mean - spread > torch.maximum(floor, 1e-4 * mean))
        within = self._contains(torch.stack((start, found)), topography_view)
        status = torch.zeros_like(given, dtype=torch.uint8)
        # From the last reason to the first, so that the first that applies remains.
        for reason, fine in (
            (TrackStatus.FORWARD_BACKWARD, returned & (error <= self.forward_backward_limit)),
            (TrackStatus.MISMATCH, energy * (1 - _MISMATCH_LIMIT) <= explained),
            (TrackStatus.NOT_CONVERGED, converged),
            (TrackStatus.NO_TEXTURE, textured),
            (TrackStatus.LEFT_FRAME, within),
            (TrackStatus.NOT_FINITE, given),
        ):
            status = torch.where(fine, status, int(reason))
        tracked = status == 0
        covariance = torch.where(tracked, 2 * variance * inverse, torch.nan)
        return StreamTracks(
            torch.where(tracked, found, torch.nan).T.reshape(*shape, 2),
            torch.where(returned & given, error, torch.nan).reshape(shape),
            covariance.T.reshape(*shape, 2, 2),
            status.reshape(shape),
        )

    def _solve(self, table: Tensor, product: Tensor, preconditioner: Tensor, shift: Tensor) -> tuple[Tensor, Tensor]:
        """The shift (2, P) at which a table equals product (2, P), and the length (P) of the last step.

        The table is (taps, 2 taps, P) as `Windows.table_of` has it, the preconditioner (2, 2, P) the inverse of the
        structure tensor.
        """
        reach, taps = self.windows.reach, self.windows.taps
        step, inverse = shift, preconditioner
        for number in range(_GAUSS_NEWTON_STEPS + _NEWTON_STEPS):
            functions = features(shift, reach)
            x, y = functions[:, :1], functions[:, 1:]
            rows = sum_first(table * y).unflatten(0, (taps, 2))
            residual = sum_first(rows * x) - product
            if number == _GAUSS_NEWTON_STEPS:
                slopes = feature_slopes(shift, reach)
                columns = sum_first(table * slopes[:, 1:]).unflatten(0, (taps, 2))
                inverse = self._inverse(sum_first(rows * slopes[:, :1]), sum_first(columns * x))
            moved = (shift - sum_rows(inverse * residual)).clamp(-reach, reach)
            step, shift = shift - moved, moved
        # A singular Jacobian leaves NaN: no root.
        good = finite(shift)
        return torch.where(good, shift, 0.0), _length(torch.where(good, step, float(reach)))

    def _way_back(self, terms: Tensor, rest: Tensor) -> tuple[Tensor, Tensor]:
        """Where the window found in the frame lies in the key frame, from the template's place (2, P), and the length
        (P) of the last step.

        `terms` (5, 2, P) are the sums of the found window's gradients times the template's derivatives
        (`Templates.template_slopes`), and rest (2, P) those times the difference of the two windows.
        """
        x, y, xx, xy, yy = terms
        back = sum_rows(self._inverse(x, y) * rest)
        step, inverse = back, None
        for _ in range(_BACK_STEPS):
            right, down = back[:1], back[1:]
            of_x, of_y = xx * right + xy * down, yy * down
            residual = (x + of_x) * right + (y + of_y) * down - rest
            if inverse is None:
                inverse = self._inverse(x + of_x + xx * right, y + xy * right + 2 * of_y)
            step = sum_rows(inverse * residual)
            back = back - step
        good = finite(back)
        reach = float(self.windows.reach)
        return torch.where(good, back, reach), _length(torch.where(good, step, reach))

    def _inverse(self, x: Tensor, y: Tensor) -> Tensor:
        """Inverses (2, 2, P) of matrices with columns x and y (2, P); not finite where they are singular."""
        adjugate = self.turn @ torch.stack((y, -x))  # (2, 2, P): turned, the cross product with the other column
        return adjugate / sum_first(adjugate[0] * x)

    def _contains(self, points: Tensor, view: Tensor) -> Tensor:
        """(P) whether window and table lie in the frame at all points (K, 2, P)."""
        height, width = view.shape[-2:]
        middle = torch.tensor([[(width - 1) / 2], [(height - 1) / 2]], dtype=points.dtype, device=points.device)
        room = middle - (self.windows.size // 2 + self.windows.margin)
        return ((points - middle).abs() - room).flatten(0, 1).amax(0) <= 0


def _length(vectors: Tensor) -> Tensor:
    """(P) of (2, P)."""
    return sum_first(vectors * vectors).sqrt()
