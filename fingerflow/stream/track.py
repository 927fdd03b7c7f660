"""Points of the key frame found in a frame: correlation tables, a fixed number of steps, and the way back."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.ops.tracking import CONVERGED, GRADIENT_NOISE, TEXTURE_TO_NOISE, VALUE_NOISE, TrackStatus
from fingerflow.stream.finite import finite
from fingerflow.stream.key import Templates
from fingerflow.stream.spline_features import feature_slopes, features
from fingerflow.stream.windows import Windows

_GAUSS_NEWTON_STEPS = 2  # safe far from the root: each leaves a fifth of the error
_NEWTON_STEPS = 2  # quadratic near it: 0.04 px become 4e-4 and 4e-8
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
        exact_return: find every point again in the key frame from where it was found. Otherwise one Gauss-Newton step
            from the start tells how far it would end from there: the same to first order, at a fifth of the time.
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
        windows, n, samples = self.windows, self.windows.size, self.windows.size**2
        start, guess = templates.template_start, prediction.to(windows.precision)
        template, level = templates.template_values.flatten(0, 1), templates.template_level.reshape(-1, 1, 1)
        noise = templates.template_noise.flatten()
        given = finite(start + guess).all(-1)
        guess = torch.where(finite(guess), guess, 0.0)
        center = guess.round()
        patches = windows.patches(topography_view, center) - level
        table = windows.shifted_rows(patches) @ templates.template_gradients.flatten(0, 1)
        products = templates.template_products.transpose(0, 1).flatten(1)  # (6, P)
        xx, xy, yy, tt = products[0], products[1], products[2], products[5]
        determinant = xx * yy - xy * xy
        regular = determinant > _TINY
        inverse = torch.stack((yy, -xy, -xy, xx)) / torch.where(regular, determinant, 1.0)  # (4, P)
        preconditioner = inverse.reshape(2, 2, -1)
        shift, step = self._solve(
            table.permute(1, 2, 0), products[3:5], preconditioner, _components_first(guess - center)
        )
        converged = (shift.abs().amax(1) < windows.reach) & (step < CONVERGED)  # (1, P)
        found = center + shift.permute(0, 2, 1).reshape(center.shape)

        sampled = windows.sample(patches, shift)
        matched, gradient = sampled[:, :n, :n], (sampled[:, :n, n:], sampled[:, n:, :n])
        difference = matched - template
        squares, own = ((a * a).sum((1, 2)) for a in (difference, matched))
        total = matched.sum((1, 2))
        together = (tt + own - squares) / 2  # the template's mean is 0
        noise_energy = noise * (samples * _VALUE_NOISE)
        energy = (tt - noise_energy).clamp_min(0) * (own - total * total / samples - noise_energy).clamp_min(0)
        explained = together * together.clamp_min(0)
        rounding = 0.0 if topography_view.is_floating_point() else 1 / 12
        variance = (squares / ((samples - 4) * 2 * _VALUE_NOISE)).clamp_min(rounding)

        rest = matched if self.exact_return else difference
        product = torch.stack([(slope * rest).sum((1, 2)) for slope in gradient])  # (2, P)
        if self.exact_return:
            back_table = windows.shifted_gradients(torch.stack(gradient, dim=1)) @ templates.template_rows.flatten(0, 1)
            known = torch.where(finite(start), start, 0.0)
            fraction = _components_first(known - known.round())
            # As far to go as the way there was, but no further than the table reaches.
            begin = (fraction + _components_first(found - guess)).clamp(-windows.reach, windows.reach)
            back, back_step = self._solve(back_table.permute(2, 1, 0), product, preconditioner, begin)
            away = (back - fraction).square().sum((0, 1))
            returned = (back.abs().amax(1) < windows.reach) & (back_step < CONVERGED) & converged
        else:
            away = (preconditioner * product[None]).sum(1).square().sum(0)
            returned = converged
        error = away.sqrt()

        mean, half = (xx + yy) / 2, (xx - yy) / 2
        spread = (half * half + xy * xy).sqrt()
        floor = noise.clamp_min(rounding) * (TEXTURE_TO_NOISE * samples * _GRADIENT_NOISE)
        textured = regular & (mean - spread > torch.maximum(floor, 1e-4 * mean))
        within = self._contains(start, topography_view) & self._contains(found, topography_view)
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
            status = torch.where(fine.reshape(given.shape), status, int(reason))
        tracked = status == 0
        covariance = (2 * variance * inverse).T.reshape(*given.shape, 2, 2)
        return StreamTracks(
            torch.where(tracked[..., None], found, torch.nan),
            torch.where(returned.reshape(given.shape) & given, error.reshape(given.shape), torch.nan),
            torch.where(tracked[..., None, None], covariance, torch.nan),
            status,
        )

    def _solve(self, table: Tensor, product: Tensor, preconditioner: Tensor, shift: Tensor) -> tuple[Tensor, Tensor]:
        """The shift (1, 2, P) at which a table equals product (2, P), and the length (1, P) of the last step.

        The table is (taps along x, 2 taps along y, P), its second axis 2 k + c for component c at shift k; the
        preconditioner (2, 2, P) is the inverse of the structure tensor.
        """
        spline, reach, taps, count = self.windows.spline, self.windows.reach, self.windows.taps, shift.shape[2]
        by_x = (spline.T @ table.flatten(1)).reshape(taps, taps, 2 * count)
        poly = (spline.T @ by_x).reshape(taps, taps, 2, count)
        step = shift
        for number in range(_GAUSS_NEWTON_STEPS + _NEWTON_STEPS):
            functions = features(shift, reach)
            x, y = functions[:, None, :1], functions[:, 1:]
            rows = (poly * x).sum(0)  # (taps along y, 2, P)
            residual = (rows * y).sum(0, keepdim=True) - product  # (1, 2, P)
            if number < _GAUSS_NEWTON_STEPS:
                step = (preconditioner * residual).sum(1)[None]
            else:
                slopes = feature_slopes(shift, reach)
                by_x = ((poly * slopes[:, None, :1]).sum(0) * y).sum(0, keepdim=True)
                by_y = (rows * slopes[:, 1:]).sum(0, keepdim=True)
                # Cramer's rule: the determinant, and those with a column replaced by the residual.
                crossed = (torch.cat((by_x, residual, by_x)) * (self.turn @ torch.cat((by_y, by_y, residual)))).sum(1)
                step = (crossed[1:] / crossed[:1])[None]
            moved = (shift - step).clamp(-reach, reach)
            step, shift = shift - moved, moved
        # A singular Jacobian leaves NaN: no root.
        good = finite(shift)
        return torch.where(good, shift, 0.0), torch.where(good, step, float(reach)).square().sum(1).sqrt()

    def _contains(self, points: Tensor, view: Tensor) -> Tensor:
        """(B, N) whether window and table lie in the frame."""
        height, width = view.shape[-2:]
        least = self.windows.size // 2 + self.windows.margin
        most = torch.tensor([width - 1 - least, height - 1 - least], dtype=points.dtype, device=points.device)
        return ((points >= least) & (points <= most)).all(-1)


def _components_first(points: Tensor) -> Tensor:
    """(B, N, 2) to (1, 2, P)."""
    return points.reshape(1, -1, 2).transpose(1, 2)
