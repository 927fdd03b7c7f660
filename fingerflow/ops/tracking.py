"""Tracking of points between two images by Lucas-Kanade on correlation tables."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from fingerflow import kernels
from fingerflow.ops.correlation_table import find_templates
from fingerflow.ops.noise import estimate_noise
from fingerflow.ops.search import search_windows
from fingerflow.ops.spline import spline_coefficients
from fingerflow.ops.windows import sample_windows

# A window has texture in every direction if its weaker gradient energy is this many times what noise alone gives it.
TEXTURE_TO_NOISE = 2.0
# What white pixel noise of variance 1 leaves in the spline's value and in a component of its gradient, by order. For
# order 3 it depends on the fractional position by 2 % and less, for order 1 by 20 %.
VALUE_NOISE = {1: 0.115, 3: 0.0907}
GRADIENT_NOISE = {1: 0.0854, 3: 0.0488}
# px, the last step: an exact Newton step of that length leaves some 1e-5 px unless there is no root.
CONVERGED = 1e-2
_ROUNDS = 5  # tables a point may use up before it counts as not found
_RETURN_STEPS = 6  # of Newton on the way back of a deformed window
_REACH = 1  # px the estimate may move within one table


class TrackStatus(IntEnum):
    """Why a point has a position, or has none. The first reason that applies is given."""

    TRACKED = 0
    NOT_FINITE = 1  # the given position, or a pixel of the window, is NaN or infinite
    LEFT_FRAME = 2  # the window does not lie inside both images
    NO_TEXTURE = 3  # blank, saturated, or structured in one direction only (aperture problem)
    NOT_CONVERGED = 4  # no root of the normal equations near the prediction
    MISMATCH = 5  # what was found looks different from the template
    FORWARD_BACKWARD = 6  # tracking back does not return to the start


class Tracks(NamedTuple):
    """Tracked points.

    Attributes:
        points: (B, N, 2) px in the current image; NaN where the status is not TRACKED.
        error: (B, N) px, forward-backward distance; NaN where it could not be computed.
        covariance: (B, N, 2, 2) px^2 of ``points``, from the residual's noise and the template's structure tensor;
            NaN as ``points``.
        status: (B, N) uint8, a :class:`TrackStatus`.
    """

    points: Tensor
    error: Tensor
    covariance: Tensor
    status: Tensor


def track_points(
    previous: Tensor,
    current: Tensor,
    points: Tensor,
    window: int = 21,
    *,
    initial: Tensor | None = None,
    warp: Tensor | None = None,
    order: int = 3,
    gain_offset: bool = False,
    search: int = 0,
    forward_backward_limit: float = 1.0,
    mismatch_limit: float = 0.05,
    noise: Tensor | None = None,
) -> Tracks:
    """Finds the points of ``previous`` in ``current``, and from there back again.

    The estimate solves sum_w g (S_current(y + w) - S_previous(p + w)) = 0 for y: Lucas & Kanade (1981) with the
    template's gradient g, evaluated through correlation tables. The way back solves the same from where the point was
    found. With a warp F the previous image is sampled at p + F^-1 w, both ways. Gradients flow to the images and to
    ``points`` through ``points`` of the result (implicit differentiation, first order); error, covariance and status
    carry none.

    Args:
        previous: (B, 1, H, W), 8 to 16 bit or floating.
        current: the same shape.
        points: (B, N, 2) (x, y) px in ``previous``; NaN stays NaN.
        window: odd side of the square window, px.
        initial: (B, N, 2) predicted positions in ``current``; default ``points``.
        warp: (B, N, 2, 2) deformation gradient F: an offset w in ``previous`` is F w in ``current``. Default identity.
        order: of the spline, 3 or 1 (faster to evaluate, less accurate).
        gain_offset: solve for brightness gain and offset of each window too.
        search: px. Points that are not found near the prediction are searched for exhaustively up to this distance in
            x and y, and only they; 0 never searches. The prediction alone reaches about a third of the texture's
            period.
        forward_backward_limit: px, points beyond it are flagged.
        mismatch_limit: largest share of the template's variance, noise discounted, that the match may leave
            unexplained.
        noise: (B,) standard deviation of white noise, grey levels, of the noisier of each two images. Default
            :func:`~fingerflow.ops.noise.estimate_noise` of both.

    Raises:
        ValueError: shapes that do not fit, an even window, an unknown order.
    """
    _check(previous, current, points, window, order, initial, warp, noise)
    batch, count = points.shape[:2]
    images = _Images(_real(previous), _real(current))
    dtype = torch.float64 if previous.dtype == torch.float64 else torch.float32
    image_index = torch.arange(batch, device=points.device).repeat_interleave(count)
    start = points.to(dtype).reshape(-1, 2)
    guess = start if initial is None else initial.to(dtype).reshape(-1, 2)
    deformation = None if warp is None else warp.to(dtype).reshape(-1, 2, 2)
    if noise is None:
        noise = torch.maximum(estimate_noise(images.previous.detach()), estimate_noise(images.current.detach()))
    noise = noise.to(dtype)
    # Integer images carry at least the noise of rounding, also where two of them do not differ.
    rounding = 0.0 if previous.is_floating_point() else 1 / 12

    problem = _Pair(images, image_index, noise[image_index], rounding, window, order, gain_offset)
    limits = (forward_backward_limit, mismatch_limit)
    found = problem.track(start, guess, None, deformation, *limits)
    if search > 0:
        lost = torch.nonzero(found.status >= TrackStatus.NOT_CONVERGED).squeeze(-1)
        if lost.numel():
            with torch.no_grad():
                where = (image_index[lost], start[lost], guess[lost])
                ahead = search_windows(images.previous, images.current, *where, window, search)
                # Searched for backward too: the way back must not know the way there.
                back = search_windows(images.current, images.previous, where[0], ahead, start[lost], window, search)
            again = problem.subset(lost).track(
                start[lost], ahead, back, None if deformation is None else deformation[lost], *limits
            )
            found = Tracks(*(whole.index_copy(0, lost, part) for whole, part in zip(found, again, strict=True)))
    return Tracks(*(flat.view(batch, count, *flat.shape[1:]) for flat in found))


def _check(
    previous: Tensor,
    current: Tensor,
    points: Tensor,
    window: int,
    order: int,
    initial: Tensor | None,
    warp: Tensor | None,
    noise: Tensor | None,
) -> None:
    for name, image in (("previous", previous), ("current", current)):
        if image.ndim != 4 or image.shape[1] != 1:
            raise ValueError(f"{name} must be (B, 1, H, W), not {tuple(image.shape)}")
    if previous.shape != current.shape:
        raise ValueError(
            f"previous {tuple(previous.shape)} and current {tuple(current.shape)} must have the same shape"
        )
    if min(previous.shape[-2:]) < 3:
        raise ValueError(f"images must be at least 3 x 3 px, not {tuple(previous.shape[-2:])}")
    if warp is not None and order == 3 and min(previous.shape[-2:]) < 4:
        raise ValueError(f"images must be at least 4 x 4 px for a warp, not {tuple(previous.shape[-2:])}")
    if points.ndim != 3 or points.shape[0] != previous.shape[0] or points.shape[2] != 2:
        raise ValueError(f"points must be (B, N, 2) with B = {previous.shape[0]}, not {tuple(points.shape)}")
    if not points.is_floating_point():
        raise ValueError(f"points must be floating point, not {points.dtype}: use points.float()")
    if initial is not None and initial.shape != points.shape:
        raise ValueError(f"initial {tuple(initial.shape)} must have the shape of points {tuple(points.shape)}")
    if warp is not None and warp.shape != (*points.shape, 2):
        raise ValueError(f"warp {tuple(warp.shape)} must be {(*points.shape, 2)}: one 2 x 2 matrix a point")
    if noise is not None and noise.shape != (len(previous),):
        raise ValueError(f"noise {tuple(noise.shape)} must be ({len(previous)},): one standard deviation an image pair")
    if window < 5 or window % 2 == 0:
        raise ValueError(f"window must be odd and at least 5 px, not {window}")
    if order not in (1, 3):
        raise ValueError(f"order must be 1 or 3, not {order}")


def _real(image: Tensor) -> Tensor:
    """The image itself, or as float32 where its number type is a rare one."""
    return image if image.dtype in kernels.FRAME_KINDS or image.dtype == torch.float64 else image.float()


@dataclass(frozen=True)
class _Images:
    """Two images (B, 1, H, W), and their spline coefficients, of whole frames only where something asks for them."""

    previous: Tensor
    current: Tensor

    @cached_property
    def coefficients(self) -> tuple[Tensor, Tensor]:
        return spline_coefficients(self.previous), spline_coefficients(self.current)


class _Pair(NamedTuple):
    """Two images and P points between them, flattened over the batch."""

    images: _Images
    image_index: Tensor
    noise: Tensor  # (P,) standard deviation of the white noise in the image of each point, grey levels
    rounding: float  # least variance of a pixel
    window: int
    order: int
    gain_offset: bool

    def subset(self, chosen: Tensor) -> "_Pair":
        return self._replace(image_index=self.image_index[chosen], noise=self.noise[chosen])

    def track(
        self,
        start: Tensor,
        guess: Tensor,
        back_guess: Tensor | None,
        warp: Tensor | None,
        forward_backward_limit: float,
        mismatch_limit: float,
    ) -> Tracks:
        """Forward, backward, and the verdict, for (P, 2) points; without ``back_guess`` the way back starts with the
        motion that was predicted, reversed, so that it has as far to go as the way there."""
        if self._compiled(start, guess, back_guess, warp):
            return Tracks(
                *kernels.track_points(
                    (self.images.previous, self.images.current),
                    self.image_index,
                    self.noise,
                    start,
                    guess,
                    back_guess,
                    warp,
                    window=self.window,
                    gain_offset=self.gain_offset,
                    rounding=self.rounding,
                    forward_backward_limit=forward_backward_limit,
                    mismatch_limit=mismatch_limit,
                )
            )
        given = start.isfinite().all(-1) & guess.isfinite().all(-1)
        inverse_warp = None
        if warp is not None:
            given = given & (warp.isfinite() & _inverse_2x2(warp).isfinite()).flatten(1).all(-1)
            warp = torch.where(given[:, None, None], warp, torch.eye(2, dtype=warp.dtype, device=warp.device))
            inverse_warp = _inverse_2x2(warp)
        start = torch.where(given[:, None], start, 0.0)
        guess = torch.where(given[:, None], guess, 0.0)

        template, slope = self._sample(0, start, inverse_warp)
        gradient, hessian = self._normal_equations(template, slope)
        found, converged = self._solve(1, guess, template, gradient, hessian)
        # In the current image windows are squares; only the template is deformed.
        matched, back_slope = self._sample(1, found, None)
        points = found
        if template.requires_grad or matched.requires_grad:
            points = self._with_derivative(found, template, gradient)
        with torch.no_grad():
            back_gradient, back_hessian = self._normal_equations(matched, back_slope)
            if inverse_warp is not None:
                back, returned = self._return_warped(start, back_guess, matched, back_gradient, inverse_warp)
            else:
                if back_guess is None:
                    back_guess = found - (guess - start)
                back, returned = self._solve(0, back_guess, matched, back_gradient, back_hessian)
            error = torch.where(converged & returned, (back - start).square().sum(-1).sqrt(), torch.nan)
            variance, unexplained = self._compare(template, matched)
            covariance, textured = self._uncertainty(hessian, variance)
            finite = given & (template.isfinite() & matched.isfinite()).flatten(1).all(-1)
            status = torch.full_like(self.image_index, int(TrackStatus.TRACKED))
            # From the last reason to the first, so that the first that applies remains.
            for reason, applies in (
                (TrackStatus.FORWARD_BACKWARD, ~(error <= forward_backward_limit)),
                (TrackStatus.MISMATCH, ~(unexplained <= mismatch_limit)),
                (TrackStatus.NOT_CONVERGED, ~converged),
                (TrackStatus.NO_TEXTURE, ~textured),
                (TrackStatus.LEFT_FRAME, ~(self._contains(start) & self._contains(found))),
                (TrackStatus.NOT_FINITE, ~finite),
            ):
                status = torch.where(applies, int(reason), status)
            tracked = status == TrackStatus.TRACKED
            covariance = torch.where(tracked[:, None, None], covariance, torch.nan)
            error = torch.where(given, error, torch.nan)
        return Tracks(torch.where(tracked[:, None], points, torch.nan), error, covariance, status.to(torch.uint8))

    def _compiled(self, *points: Tensor | None) -> bool:
        """Whether the compiled twin takes these points."""
        images = self.images.previous, self.images.current
        return (
            self.order == 3
            and all(image.dtype in kernels.FRAME_KINDS for image in images)
            and min(images[0].shape[-2:]) >= 4
            and kernels.serve(*images, self.image_index, self.noise, *points)
        )

    def _sample(self, which: int, points: Tensor, warp: Tensor | None) -> tuple[Tensor, Tensor]:
        """Windows (P, n, n) and their gradient (P, 2, n, n)."""
        image = self.images.coefficients[which]
        if self.order == 3:
            return sample_windows(image, self.image_index, points, self.window, 3, warp)
        # The slope of a polygon is that of one side: at whole pixels half a pixel off. Central differences are not.
        around, _ = sample_windows(image, self.image_index, points, self.window + 2, 1, warp)
        along_x = (around[:, 1:-1, 2:] - around[:, 1:-1, :-2]) / 2
        along_y = (around[:, 2:, 1:-1] - around[:, :-2, 1:-1]) / 2
        return around[:, 1:-1, 1:-1], torch.stack((along_x, along_y), dim=1)

    def _contains(self, points: Tensor) -> Tensor:
        """(P,) whether the window lies in the frame."""
        height, width = self.images.previous.shape[-2:]
        half = self.window // 2
        x, y = points[:, 0], points[:, 1]
        return (x >= half) & (y >= half) & (x <= width - 1 - half) & (y <= height - 1 - half)

    def _normal_equations(self, template: Tensor, gradient: Tensor) -> tuple[Tensor, Tensor]:
        """The gradient that the equations use, and the (P, 2, 2) matrix of its products."""
        if self.gain_offset:
            # Without its parts along a change of offset (a constant) and of gain (the template itself), the equations
            # hold whatever offset and gain are.
            centred = template - template.mean((-1, -2), keepdim=True)
            gradient = gradient - gradient.mean((-1, -2), keepdim=True)
            energy = centred.square().sum((-1, -2)).clamp_min(torch.finfo(template.dtype).tiny)
            share = (gradient * centred[:, None]).sum((-1, -2)) / energy[:, None]
            gradient = gradient - share[:, :, None, None] * centred[:, None]
        flat = gradient.flatten(2)
        return gradient, flat @ flat.transpose(1, 2)

    def _solve(
        self, which: int, guess: Tensor, template: Tensor, gradient: Tensor, hessian: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Position of each template in image ``which`` (finite, without derivative), and whether it solves the
        equations."""
        with torch.no_grad():
            match = find_templates(
                self.images.coefficients[which],
                self.image_index,
                guess,
                gradient,
                template,
                _inverse_2x2(hessian).nan_to_num(0.0, 0.0, 0.0),
                self.order,
                _REACH,
                _ROUNDS,
            )
            converged = match.inside & (match.step < CONVERGED)
            return torch.where(match.points.isfinite(), match.points, guess), converged

    def _return_warped(
        self, start: Tensor, guess: Tensor | None, matched: Tensor, gradient: Tensor, inverse_warp: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Where in the first image, deformed like the template, the equations of the way back hold, and whether they
        do: by Newton's steps from the start, or from ``guess``. A deformed image has no table."""
        place = (start if guess is None else guess).clone()
        returned = torch.zeros_like(place[:, 0], dtype=torch.bool)
        left = torch.arange(len(place), device=place.device)
        for _ in range(_RETURN_STEPS):
            one = self.subset(left)
            image, slope = one._sample(0, place[left], inverse_warp[left])
            residual = (gradient[left] * (image - matched[left])[:, None]).sum((-1, -2))
            jacobian = gradient[left].flatten(2) @ slope.flatten(2).transpose(1, 2)
            step = (_inverse_2x2(jacobian) * residual[:, None, :]).sum(-1)
            goes_on = step.isfinite().all(-1)  # it has no root where it is singular
            step = torch.where(goes_on[:, None], step.clamp(-1, 1), 0.0)
            place[left] -= (inverse_warp[left] * step[:, None, :]).sum(-1)
            near = step.square().sum(-1).sqrt() < CONVERGED
            returned[left[goes_on & near]] = True
            left = left[goes_on & ~near]
            if left.numel() == 0:
                break
        return place, returned

    def _with_derivative(self, found: Tensor, template: Tensor, gradient: Tensor) -> Tensor:
        """The same points, with their derivative: a Newton step from the root, which moves nothing.

        At the root b(y; images, p) = 0, hence dy = -(db/dy)^-1 db; the Jacobian itself needs no derivative.
        """
        value, slope = sample_windows(self.images.coefficients[1], self.image_index, found, self.window, self.order)
        centred = value - template if not self.gain_offset else value - value.mean((-1, -2), keepdim=True)
        residual = (gradient * centred[:, None]).sum((-1, -2))
        jacobian = (gradient.flatten(2) @ slope.flatten(2).transpose(1, 2)).detach()
        return found - (_inverse_2x2(jacobian) * residual[:, None, :]).sum(-1)

    def _compare(self, reference: Tensor, matched: Tensor) -> tuple[Tensor, Tensor]:
        """Noise variance of a pixel that the residual shows, and the share of the template that the match does not
        explain."""
        samples = self.window**2
        a = reference - reference.mean((-1, -2), keepdim=True)
        b = matched - matched.mean((-1, -2), keepdim=True)
        aa, bb, ab = (a * a).sum((-1, -2)), (b * b).sum((-1, -2)), (a * b).sum((-1, -2))
        squares = (matched - reference).square().sum((-1, -2))
        if self.gain_offset:
            squares = bb - ab.square() / aa.clamp_min(torch.finfo(aa.dtype).tiny)
        variance = squares / (samples - 4) / (2 * VALUE_NOISE[self.order])
        # The correlation that the two would have without noise: its energy is taken off both.
        noise_energy = samples * self.noise.square() * VALUE_NOISE[self.order]
        energy = (aa - noise_energy).clamp_min(0) * (bb - noise_energy).clamp_min(0)
        return variance.clamp_min(self.rounding), 1 - ab * ab.clamp_min(0) / energy

    def _uncertainty(self, hessian: Tensor, variance: Tensor) -> tuple[Tensor, Tensor]:
        """Covariance of a tracked position, 2 sigma^2 G^-1 (the Cramer-Rao bound for two noisy images), and whether the
        window holds more structure in its weaker direction than noise would put there."""
        mean = (hessian[:, 0, 0] + hessian[:, 1, 1]) / 2
        spread = (((hessian[:, 0, 0] - hessian[:, 1, 1]) / 2).square() + hessian[:, 0, 1].square()).sqrt()
        noise_energy = self.window**2 * self.noise.square().clamp_min(self.rounding) * GRADIENT_NOISE[self.order]
        # Without any noise, rounding is what gives a grating a second direction.
        textured = mean - spread > torch.maximum(TEXTURE_TO_NOISE * noise_energy, 1e-4 * mean)
        return 2 * variance[:, None, None] * _inverse_2x2(hessian), textured


def _inverse_2x2(matrix: Tensor) -> Tensor:
    """Inverse of (P, 2, 2); not finite where singular."""
    a, b, c, d = matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 0], matrix[:, 1, 1]
    return torch.stack((d, -b, -c, a), dim=-1).view(-1, 2, 2) / (a * d - b * c)[:, None, None]
