"""Ground truth of position, onset of contact and deformation of the skin, in float64.

Everything follows from the inverse map phi(position, progress), `SyntheticScene.material`. With F = (d phi / d
position)^-1:

- a material point moves by d position / d progress = -F d phi / d progress;
- its onset solves depth(position(progress), progress) = 0. Differentiating that by the material point X gives
  grad onset = -(F^T d depth / d position) / (d depth / d progress along the point's path);
- its onset position, xi = position(X, onset(X)), has d xi / dX = F + (d position / d progress) (x) grad onset at
  the onset, because neighbours touch at another moment;
- so the displacement u = position - xi has the gradient du / dxi = F (d xi / dX)^-1 - I.

Points are arrays (..., 2) of (x, y); positions and materials are in mm, pixels are those of one view.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from fingerflow.synthetic.motion import Ellipse

if TYPE_CHECKING:
    from fingerflow.synthetic.scenes import SyntheticScene

Array = NDArray[np.float64]

#: Newton's iterations end when no coordinate is off by more than this (mm); at 20 mm rounding is 4e-15 mm.
TOLERANCE = 1e-13


@dataclass(frozen=True)
class Medians:
    """True medians of deformation and displacement of the skin over the apparent contact of one frame; NaN before
    contact.

    Displacement and gradients count from the onset of each point. Divergence, curl = dv/dx - du/dy and the full
    Green-Lagrange strain (exx, eyy, exy) are dimensionless; the displacement is in mm, its median per component.
    """

    divergence: float
    curl: float
    exx: float
    eyy: float
    exy: float
    displacement_x: float
    displacement_y: float


class Truth:
    """Exact position, contact onset, deformation and contact areas of the skin in a synthetic scene, frame by frame.

    Attributes:
        progress: (frames,) progress of the movement, which never decreases.
        mm_per_px: scale of the contact view.
    """

    def __init__(self, scene: "SyntheticScene") -> None:
        self._scene, self.mm_per_px = scene, scene.mm_per_px
        self.progress = scene.progress(scene.times)
        # Map from pixels of the topography view to pixels of the contact view.
        self._matrix, self._offset = np.split(np.array(scene.topography_to_contact, dtype=np.float64), [2], axis=1)

    # Conversions between views

    def topography_pixels(self, positions: ArrayLike) -> Array:
        """Convert positions (..., 2) from mm on the glass to px of the topography view."""
        contact_px = np.asarray(positions, dtype=np.float64) / self.mm_per_px
        return (contact_px - self._offset[:, 0]) @ np.linalg.inv(self._matrix).T

    def topography_positions(self, pixels: ArrayLike) -> Array:
        """Convert positions (..., 2) from px of the topography view to mm on the glass."""
        return (np.asarray(pixels, dtype=np.float64) @ self._matrix.T + self._offset[:, 0]) * self.mm_per_px

    # Motion of the skin

    def material(self, positions: ArrayLike, frame: int) -> Array:
        """Return the material coordinates (mm) of the skin at positions (..., 2) on the glass in a frame."""
        x, y = _points(positions).unbind(-1)
        return torch.stack(self._scene.material(x, y, self._frame_progress(frame)), dim=-1).numpy()

    def positions(self, material: ArrayLike, frame: int) -> Array:
        """Return the positions (mm) on the glass of material points (..., 2) in a frame."""
        points = _points(material)
        return self._forward(points, self._frame_progress(frame).expand(points.shape[:-1]), points).numpy()

    def follow(self, topography_pixels: ArrayLike, from_frame: int, to_frame: int) -> Array:
        """Return the topography pixels (..., 2) in frame `to_frame` of skin at given pixels in frame `from_frame`."""
        material = self.material(self.topography_positions(topography_pixels), from_frame)
        return self.topography_pixels(self.positions(material, to_frame))

    # Contact areas

    def ellipse(self, frame: int) -> Ellipse | None:
        """Return the edge of the apparent contact in a frame, mm; None before contact."""
        return self._scene.ellipse(float(self.progress[frame]))

    def contact_mask(self, frame: int) -> NDArray[np.bool_]:
        """Return the mask (H, W) of pixels of the contact view whose centre lies on a part of a ridge that touches the
        glass.
        """
        ellipse = self.ellipse(frame)
        if ellipse is None:
            return np.zeros(self._scene.views["contact"].shape, dtype=bool)
        rows, columns = self._scene.views["contact"].shape
        down, right = (torch.arange(size, dtype=torch.float64) * self.mm_per_px for size in (rows, columns))
        y, x = torch.meshgrid(down, right, indexing="ij")
        return (self._contact_margin(x, y, frame, ellipse) > 0).numpy()

    def gross_contact_area_mm2(self, frame: int) -> float:
        """Return the area of the elliptic apparent contact in a frame, mm²."""
        ellipse = self.ellipse(frame)
        return 0.0 if ellipse is None else ellipse.area

    def real_contact_area_mm2(self, frame: int) -> float:
        """Return the real contact area (mm²) in a frame, by quadrature with 16 cells per pixel."""
        ellipse = self.ellipse(frame)
        if ellipse is None:
            return 0.0
        x, y, cell = _grid_around(ellipse, self.mm_per_px / 4)
        rows = max(1, 2**14 // x.shape[1])  # of which the intermediate results stay in a cache
        parts = zip(x.split(rows), y.split(rows), strict=True)
        margins = (self._contact_margin(*part, frame, ellipse) for part in parts)
        return sum(float((margin / cell + 0.5).clamp(0, 1).sum()) for margin in margins) * cell**2

    # Deformation since the onset

    def onset_frame(self, material: ArrayLike) -> NDArray[np.int64]:
        """Return the first frame whose apparent contact contains material points (..., 2); -1 if there is none."""
        onset = self._onset(_points(material))[0].numpy()
        frames = np.searchsorted(self.progress, np.nan_to_num(onset, nan=np.inf), side="left")
        return np.where(frames < len(self.progress), frames, -1)

    def displacement(self, material: ArrayLike, frame: int, reference: int | None = None) -> Array:
        """Return the displacement (..., 2) in mm of material points (..., 2) in a frame, since their onset of contact
        or since a frame `reference`.

        It is NaN before the onset and for points without one.
        """
        points = _points(material)
        return self._displacement(points, frame, *self._onset(points), reference).numpy()

    def gradient(self, material: ArrayLike, frame: int, reference: int | None = None) -> Array:
        """Return the gradient (..., 2, 2), dimensionless, of the skin's displacement since the onset of contact at
        material points, with respect to the positions at onset.

        With `reference` it is F(frame) F(reference)^-1 - I, the gradient since that frame by the positions there, at
        points that touch. [..., 0, 1] is du/dy. It is NaN where the displacement is NaN, and for skin advected across
        the edge of a stationary contact: the onset positions of neighbours then lie on one line and define no gradient.
        """
        points = _points(material)
        return self._gradient(points, frame, *self._onset(points), reference).numpy()

    def entry_gradient(self, material: ArrayLike, frame: int) -> Array:
        """Return the displacement gradient F(frame) F(onset)^-1 - I (..., 2, 2) of the skin around material points
        since each touched the glass, with F the deformation gradient.

        It exists also for skin advected across a stationary edge, and is NaN before the onset.
        """
        points = _points(material)
        onset, entry = self._onset(points)
        return self._gradient_since(points, frame, onset, self._derivatives(entry, onset)[0]).numpy()

    def medians(self, frame: int, spacing_mm: float = 0.1, reference: int | None = None) -> Medians:
        """Return the true medians of deformation over the apparent contact of a frame, from a square grid of positions.

        Deformation counts from the onset of each point, or from frame `reference`; positions without a gradient are
        ignored.
        """
        ellipse = self.ellipse(frame)
        if ellipse is None:
            return Medians(*(math.nan,) * 7)
        # Choose the spacing so that a small contact gets as many grid points as a large one.
        x, y, _ = _grid_around(ellipse, min(spacing_mm, min(ellipse.semi_axes) / 8))
        points = _points(self.material(torch.stack((x, y), dim=-1)[ellipse.distance(x, y) > 0].numpy(), frame))
        onset, entry = self._onset(points)
        displacement = self._displacement(points, frame, onset, entry, reference).numpy()
        (xx, xy), (yx, yy) = np.moveaxis(self._gradient(points, frame, onset, entry, reference).numpy(), 0, -1)
        fields = (
            xx + yy,
            yx - xy,
            xx + (xx**2 + yx**2) / 2,
            yy + (xy**2 + yy**2) / 2,
            (xy + yx + xx * xy + yx * yy) / 2,
            *displacement.T,
        )
        return Medians(*(float(np.nanmedian(field)) for field in fields))

    # Solvers

    def _frame_progress(self, frame: int) -> Tensor:
        return torch.tensor(self.progress[frame], dtype=torch.float64)

    def _contact_margin(self, x: Tensor, y: Tensor, frame: int, ellipse: Ellipse) -> Tensor:
        depth, material = ellipse.distance(x, y), self._scene.material(x, y, self._frame_progress(frame))
        return torch.minimum(self._scene.ridge_margin(*material, depth), depth)

    def _displacement(self, points: Tensor, frame: int, onset: Tensor, entry: Tensor, reference: int | None) -> Tensor:
        if reference is not None:
            entry = self._forward(points, self._frame_progress(reference).expand(onset.shape), points)
        moved = self._forward(points, self._frame_progress(frame).expand(onset.shape), points) - entry
        return torch.where((onset <= self._frame_progress(frame))[..., None], moved, math.nan)

    def _gradient(self, points: Tensor, frame: int, onset: Tensor, entry: Tensor, reference: int | None) -> Tensor:
        if reference is not None:
            return self._gradient_since(points, frame, onset, self._deformation(points, reference))
        forward, velocity = self._derivatives(entry, onset)
        slope, rate = self._depth_derivatives(entry, onset)
        closing = (slope * velocity).sum(-1) + rate
        onset_gradient = -(slope[..., None, :] @ forward) / closing[..., None, None]
        # Points inside at the start have their onset at progress 0, as do their neighbours.
        onset_gradient = torch.where((onset > 0)[..., None, None], onset_gradient, 0.0)
        place_gradient = forward + velocity[..., None] * onset_gradient
        gradient = self._gradient_since(points, frame, onset, place_gradient)
        return torch.where((torch.linalg.det(place_gradient).abs() > 1e-9)[..., None, None], gradient, math.nan)

    def _gradient_since(self, points: Tensor, frame: int, onset: Tensor, reference: Tensor) -> Tensor:
        """Return the displacement gradient (..., 2, 2) of material points in a frame since a state with the deformation
        gradient ``reference``; NaN before their `onset` of contact, a progress.
        """
        inverse, _ = torch.linalg.inv_ex(reference)
        gradient = self._deformation(points, frame) @ inverse - torch.eye(2, dtype=torch.float64)
        return torch.where((onset <= self._frame_progress(frame))[..., None, None], gradient, math.nan)

    def _deformation(self, points: Tensor, frame: int) -> Tensor:
        """Return the deformation gradient F (..., 2, 2), d position / d material coordinates, at material points in a
        frame.
        """
        progress = self._frame_progress(frame).expand(points.shape[:-1])
        return self._derivatives(self._forward(points, progress, points), progress)[0]

    def _derivatives(self, positions: Tensor, progress: Tensor) -> tuple[Tensor, Tensor]:
        """Return, for skin at positions (..., 2) on the glass at a progress of the movement, the deformation gradient
        (..., 2, 2), d position / d material, and the velocity (..., 2), d position / d progress.
        """
        with torch.enable_grad():
            positions, progress = positions.detach().requires_grad_(), progress.detach().clone().requires_grad_()
            material = self._scene.material(positions[..., 0], positions[..., 1], progress)
            rows = [torch.autograd.grad(part.sum(), (positions, progress), retain_graph=True) for part in material]
        forward, _ = torch.linalg.inv_ex(torch.stack([row for row, _ in rows], dim=-2))
        by_progress = torch.stack([rate for _, rate in rows], dim=-1)
        return forward, -(forward @ by_progress[..., None])[..., 0]

    def _depth_derivatives(self, positions: Tensor, progress: Tensor) -> tuple[Tensor, Tensor]:
        """Return the derivatives of `SyntheticScene.depth`, the dimensionless depth of positions inside the contact, by
        position (..., 2) and by progress (...).
        """
        with torch.enable_grad():
            positions, progress = positions.detach().requires_grad_(), progress.detach().clone().requires_grad_()
            depth = self._scene.depth(positions[..., 0], positions[..., 1], progress)
            slope, rate = torch.autograd.grad(depth.sum(), (positions, progress))
        return slope, rate

    def _forward(self, material: Tensor, progress: Tensor, start: Tensor) -> Tensor:
        """Return the positions (..., 2) on the glass, mm, of material points at a progress (...) of the movement, by
        Newton's method from the positions `start`.
        """
        positions = start
        for _ in range(30):
            reached = torch.stack(self._scene.material(positions[..., 0], positions[..., 1], progress), dim=-1)
            missing = material - reached
            if not (missing.abs() > TOLERANCE).any():
                # Points with NaN progress have a NaN residual, which is propagated.
                return positions + 0 * missing
            forward, _ = self._derivatives(positions, progress)
            positions = positions + (forward @ missing[..., None])[..., 0]
        worst = missing.abs().nan_to_num(0).max().item()
        raise ValueError(
            f"the motion cannot be inverted: a point is missed by {worst:.2g} mm after 30 steps of Newton's method; "
            "the skin folds where its displacement changes by 100 % or more, so make the displacement smaller"
        )

    def _onset(self, material: Tensor) -> tuple[Tensor, Tensor]:
        """Return the progress (...) and position (..., 2) at which material points enter the contact; NaN if never.

        Newton's method is confined to the bracket that contains the entry, so it cannot diverge.
        """
        steps = torch.linspace(0, 1, self._scene.entry_steps + 1, dtype=torch.float64)
        points = material.expand(len(steps), *material.shape)
        at = steps.reshape(-1, *(1,) * (material.ndim - 1)).expand(points.shape[:-1])
        entry = self._forward(points, at, points)
        inside = self._scene.depth(entry[..., 0], entry[..., 1], at) > 0
        last = torch.argmax(inside.to(torch.uint8), dim=0)
        first = (last - 1).clamp(min=0)
        upper = torch.where(inside.any(dim=0), steps[last], math.nan)
        lower = torch.where(inside.any(dim=0), steps[first], math.nan)

        onset = upper
        entry = torch.gather(entry, 0, last[None, ..., None].expand(1, *material.shape))[0]
        for _ in range(60):
            entry = self._forward(material, onset, entry)
            depth = self._scene.depth(entry[..., 0], entry[..., 1], onset)
            upper = torch.where(depth > 0, onset, upper)
            lower = torch.where(depth > 0, lower, onset)
            slope, rate = self._depth_derivatives(entry, onset)
            _, velocity = self._derivatives(entry, onset)
            guess = onset - depth / ((slope * velocity).sum(-1) + rate)
            guess = torch.where((guess < lower) | (guess > upper), (lower + upper) / 2, guess)
            settled = not ((guess - onset).abs() > TOLERANCE).any()
            onset = guess
            if settled:
                break
        return onset, self._forward(material, onset, entry)


def _points(values: ArrayLike) -> Tensor:
    points = torch.as_tensor(np.asarray(values, dtype=np.float64))
    if points.shape[-1:] != (2,):
        raise ValueError(f"points have shape {tuple(points.shape)}; the last dimension must hold x and y")
    return points


def _grid_around(ellipse: Ellipse, spacing: float) -> tuple[Tensor, Tensor, float]:
    """Return a square grid of positions (mm) that covers an ellipse, symmetric about its centre, and its spacing."""
    counts = (math.ceil(reach / spacing) + 1 for reach in ellipse.reach)
    offsets = [torch.arange(-count, count + 1, dtype=torch.float64) * spacing for count in counts]
    y, x = torch.meshgrid(offsets[1] + ellipse.centre[1], offsets[0] + ellipse.centre[0], indexing="ij")
    return x, y, spacing
