"""Points of the key frame found in a frame: a look from the key frame, one in the frame, and the way back."""

from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.ops.tracking_limits import VALUE_NOISE as _VALUE_NOISE
from fingerflow.ops.tracking_limits import TrackStatus
from fingerflow.stream.components import components_first
from fingerflow.stream.finite import finite
from fingerflow.stream.key import Templates
from fingerflow.stream.spline_features import features, features_and_slopes, taps
from fingerflow.stream.sums import sum_rows
from fingerflow.stream.windows import Windows

_TABLE_STEPS = 2  # each leaves a fifth of the error far from the root, a tenth near it
_LAST_STEP = 0.2  # px that the step in the frame may have: a window stretched by 10 % asks for 0.14, and 1e-4 are left
_BACK_STEPS = 2  # after a linear one
_MISMATCH_LIMIT = 0.05
_CONVERGED = 1e-2  # px, of the last step

WayBack = Literal["table", "step", "edges"]


class StreamTracks(NamedTuple):
    """As `ops.Tracks`: points (B, N, 2) px and covariance (B, N, 2, 2) px^2, NaN where lost; error (B, N) px; status
    (B, N) uint8."""

    points: Tensor
    error: Tensor
    covariance: Tensor
    status: Tensor


class TrackStep(nn.Module):
    """`ops.track_points` from a key frame to a frame in which points lie near their predictions.

    The first look asks where in the key frame the window lies that has its middle at a whole pixel of the frame: no
    pixel is interpolated, and the table of all shifts is the key frame's own. That is the point, but for the
    deformation over less than a pixel. The second look is at the window there, in the frame, with one step more.

    Args:
        window: odd side, px.
        reach: px from the whole pixel nearest to a prediction within which its point is found.
        way_back: how the last step is taken, and where a point of the frame would be found in the key frame.
            "table": by the slopes in the frame, to second order, and by the slopes and bends of the key frame: within
            2e-4 px of the search on a press, where points return to 0.03 px; further off it is coarser, by some percent
            of a pixel near the limit.
            "step": both by the slopes of the key frame alone: within 1e-3 px.
            "edges": as "step", and without the slopes in the frame. To first order the two ways differ by the sum over
            the window of the difference of the frames times its gradient, half the difference of its squares between
            opposite edges: errors up to a fourth smaller than those of "step", correlated with them by 0.6 to 0.75.
        forward_backward_limit: px beyond which a point counts as lost.
    """

    edges: Tensor

    def __init__(
        self,
        window: int = 21,
        reach: int = 1,
        way_back: WayBack = "table",
        forward_backward_limit: float = 1.0,
        precision: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        self.windows = Windows(window, reach, precision)
        self.register_buffer("edges", _edges(window).to(precision))
        self.way_back = way_back
        self.forward_backward_limit = forward_backward_limit

    def forward(self, topography_view: Tensor, prediction: Tensor, templates: Templates) -> StreamTracks:
        """(B, 1, H, W) view, (B, N, 2) px prediction; templates of `KeyStep`."""
        windows, samples, reach = self.windows, self.windows.size**2, self.windows.reach
        # Components before points from here on, (B, K, N).
        start = components_first(templates.template_start)
        guess = components_first(prediction.to(windows.precision))
        given = finite(start + guess)[:, :1]
        guess = torch.where(finite(guess), guess, 0.0)
        center = guess.round()
        patches = windows.patches(topography_view, center)
        *inverse, tt, bends, textured = templates.template_products.split((1, 1, 1, 1, 6, 1), dim=1)

        wanted = _times(templates.template_pixels, patches.flatten(1))
        own = start - start.round()
        beside = self._solve(templates.template_table, wanted, inverse, own + center - guess)
        looked = (own - beside).clamp(-reach, reach)

        template, gradients = templates.template_values.flatten(0, 1), templates.template_gradients
        if self.way_back == "edges":
            difference = self._values(patches, looked) - template
        else:
            matched, by_x, by_y = self._window(patches, looked)
            difference = matched - template
        off = _times(gradients, difference)
        if self.way_back == "table":
            by_right, by_down = (_times(gradients, one) for one in (by_x, by_y))
            last = _newton(by_right, by_down, off)
            last = _newton(by_right, by_down, off + _second_order(bends, last))
        else:
            last = _symmetric(inverse, off)
        length = _length(last)
        settled = length < _LAST_STEP  # a singular Jacobian leaves NaN: no root
        shift = looked - torch.where(settled, last, 0.0)
        converged = settled & _within(shift, reach)
        found = center + shift

        level, noise = templates.template_level[:, None], templates.template_noise[:, None]
        squared_difference = difference * difference
        squares, other, along = (
            one.sum(1).reshape(given.shape) for one in (squared_difference, difference, template * difference)
        )
        along = along - level * other  # of the template less its level
        # Sums of squares and products of the two windows, both less the template's level, from their difference.
        squared, together = squares + 2 * along + tt, along + tt
        noise_energy = noise * (samples * _VALUE_NOISE)
        energy = (tt - noise_energy).clamp_min(0) * (squared - other * other / samples - noise_energy).clamp_min(0)
        explained = together * together.clamp_min(0)
        # What is left at the end of the last step.
        left = squares - sum_rows(last * off)
        rounding = 0.0 if topography_view.is_floating_point() else 1 / 12
        variance = (left / ((samples - 4) * 2 * _VALUE_NOISE)).clamp_min(rounding)

        returned = converged
        if self.way_back == "edges":
            turned = (squared_difference @ self.edges).reshape(-1, given.shape[2], 2)
            back = _symmetric(inverse, components_first(turned))
        else:
            rest = torch.cat([(one * difference).sum(1).reshape(given.shape) for one in (by_x, by_y)], dim=1)
            if self.way_back == "step":
                back = _symmetric(inverse, rest - off)
            else:
                rest = rest - torch.cat((sum_rows(by_right * last), sum_rows(by_down * last)), dim=1)
                back, back_step = self._way_back(by_right, by_down, bends, rest)
                returned = converged & _within(back, reach) & (back_step < _CONVERGED)
        error = _length(back)

        # The key frame's table is one px wider.
        within = self._contains(start, topography_view, 1) & self._contains(found, topography_view)
        status = torch.zeros_like(given, dtype=torch.uint8)
        # From the last reason to the first, so that the first that applies remains.
        for reason, fine in (
            (TrackStatus.FORWARD_BACKWARD, returned & (error <= self.forward_backward_limit)),
            (TrackStatus.MISMATCH, energy * (1 - _MISMATCH_LIMIT) <= explained),
            (TrackStatus.NOT_CONVERGED, converged),
            (TrackStatus.NO_TEXTURE, textured > 0),
            (TrackStatus.LEFT_FRAME, within),
            (TrackStatus.NOT_FINITE, given),
        ):
            status = torch.where(fine, status, int(reason))
        tracked = status == 0
        lost = torch.where(tracked, 0.0, torch.nan).to(found.dtype)  # added, which runtimes do faster than to choose
        covariance = 2 * variance * torch.cat((*inverse[:2], *inverse[1:]), dim=1) + lost
        return StreamTracks(
            (found + lost).transpose(1, 2),
            torch.where(returned & given, error, torch.nan).squeeze(1),
            covariance.transpose(1, 2).unflatten(2, (2, 2)),
            status.squeeze(1),
        )

    def _solve(self, table: Tensor, wanted: Tensor, inverse: list[Tensor], shift: Tensor) -> Tensor:
        """The shift (B, 2, N) at which a table of the key frame equals `wanted` (B, 2, N), from the shift given."""
        reach, count = self.windows.reach + 1, shift.shape[2]
        places = taps(reach)
        for _ in range(_TABLE_STEPS):
            x, y = features(shift, reach).split(1, dim=2)
            lines = sum_rows((table.unflatten(1, (places, -1)) * y).flatten(2)).reshape(-1, places, 2, count)
            found = sum_rows((lines * x).flatten(2)).reshape(-1, 2, count)
            shift = (shift - _symmetric(inverse, found - wanted)).clamp(-reach, reach)
        return shift

    def _values(self, patches: Tensor, shift: Tensor) -> Tensor:
        """The windows (P, samples) at shifts (B, 2, N) in patches (P, side, side)."""
        functions = features(shift, self.windows.reach)
        x, y = (functions[:, :, axis].transpose(1, 2).flatten(0, 1) for axis in range(2))
        return (self.windows.at_y(y) @ (patches @ self.windows.at_x(x))).flatten(1)

    def _window(self, patches: Tensor, shift: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The windows at shifts (B, 2, N) in patches (P, side, side), and their slopes in x and y, (P, samples)."""
        windows = self.windows
        functions, slopes = features_and_slopes(shift, windows.reach)
        x, slope_x = (one[:, :, 0].transpose(1, 2).flatten(0, 1) for one in (functions, slopes))
        both_y = torch.stack((functions[:, :, 1], slopes[:, :, 1]), dim=1).permute(0, 3, 1, 2).flatten(0, 1)
        # Values and slopes along y one below the other, in one product.
        lines = windows.at_y(both_y).flatten(1, 2) @ patches
        matched, by_y = (lines @ windows.at_x(x)).unflatten(1, (2, -1)).flatten(2).unbind(1)
        return matched, (lines[:, : windows.size] @ windows.at_x(slope_x)).flatten(1), by_y

    def _way_back(self, by_x: Tensor, by_y: Tensor, bends: Tensor, rest: Tensor) -> tuple[Tensor, Tensor]:
        """Where the window found in the frame lies in the key frame, from the template's place (B, 2, N), and the
        length (B, 1, N) of the last step.

        `by_x` and `by_y` (B, 2, N) are the sums of the template's gradients times the found window's slopes, `rest`
        (B, 2, N) those of the slopes times the difference of the two windows.
        """
        x, y = (torch.cat((by_x[:, one : one + 1], by_y[:, one : one + 1]), dim=1) for one in range(2))
        back = step = _newton(x, y, rest)
        for _ in range(_BACK_STEPS):
            step = back - _newton(x, y, rest - _second_order(bends, back))
            back = back - step
        return back, _length(step)

    def _contains(self, points: Tensor, view: Tensor, more: int = 0) -> Tensor:
        """(B, 1, N) whether window and table, and some px more, lie in the frame at points (B, 2, N)."""
        height, width = view.shape[-2:]
        middle = torch.tensor([[(width - 1) / 2], [(height - 1) / 2]], dtype=points.dtype, device=points.device)
        room = middle - (self.windows.size // 2 + self.windows.margin + more)
        return ((points - middle).abs() - room).amax(1, keepdim=True) <= 0


def _edges(size: int) -> Tensor:
    """(size * size, 2) that takes an image to half the difference between its last and first columns, and lines."""
    ends = torch.zeros(size)
    ends[0], ends[-1] = -0.5, 0.5
    whole = torch.ones(size)
    return torch.stack((torch.outer(whole, ends), torch.outer(ends, whole)), dim=2).flatten(0, 1)


def _times(gradients: Tensor, windows: Tensor) -> Tensor:
    """(B, 2, N): sums of both gradients (B, N, 2, samples) times windows (B N, samples)."""
    batch, count = gradients.shape[:2]
    return components_first((gradients.flatten(0, 1) @ windows[..., None]).reshape(batch, count, 2))


def _symmetric(matrix: list[Tensor], vectors: Tensor) -> Tensor:
    """Products (B, 2, N) of symmetric matrices (xx, xy, yy), (B, 1, N) each, with vectors (B, 2, N)."""
    xx, xy, yy = matrix
    x, y = vectors.split(1, dim=1)
    return torch.cat((xx * x + xy * y, xy * x + yy * y), dim=1)


def _newton(by_x: Tensor, by_y: Tensor, rest: Tensor) -> Tensor:
    """Solutions (B, 2, N) of equations with columns `by_x` and `by_y` (B, 2, N); not finite where there is none."""
    (a, c), (b, d), (u, v) = (one.split(1, dim=1) for one in (by_x, by_y, rest))
    return torch.cat((d * u - b * v, a * v - c * u), dim=1) / (a * d - b * c)


def _second_order(bends: Tensor, step: Tensor) -> Tensor:
    """What the bends (B, 6, N) of a template add to a product with its gradients after a step (B, 2, N)."""
    x, y = step.split(1, dim=1)
    terms = torch.cat((x * x, x * y, y * y), dim=1)
    return torch.cat((sum_rows(bends[:, :3] * terms), sum_rows(bends[:, 3:] * terms)), dim=1)


def _within(vectors: Tensor, reach: float) -> Tensor:
    """(B, 1, N) whether both components of vectors (B, 2, N) are below the reach."""
    return vectors.abs().amax(1, keepdim=True) < reach


def _length(vectors: Tensor) -> Tensor:
    """(B, 1, N) of (B, 2, N)."""
    return sum_rows(vectors * vectors).sqrt()
