"""Base class of all synthetic fingertip scenes in the rig's layout: images, forces and ground truth.

A scene gives motion and contact of the skin in closed form. Only the inverse map is defined, material = phi(position,
progress), so that an image is an evaluation at its pixels; forward positions and all derivatives follow from it in
`fingerflow.synthetic.truth`. Time enters only as the progress of the movement from 0 to 1, so results do not depend on
its speed.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.schema.views import View
from fingerflow.synthetic import optics
from fingerflow.synthetic.camera import Camera
from fingerflow.synthetic.motion import Ellipse
from fingerflow.synthetic.skin_interface import Skin
from fingerflow.synthetic.texture import RidgeTexture
from fingerflow.synthetic.truth import Truth

Array = NDArray[np.float64]

FORCE_RATE = 10_000.0
EMPTY_PICTURES, DARK_PICTURES = -1_000_000, -2_000_000


@dataclass(frozen=True, kw_only=True)
class SyntheticScene(ABC):
    """Synthetic recording of a finger movement: images, forces and ground truth.

    Lengths are in mm, angles in rad, times in s from the trigger, forces in N. A frame has the topography view on its
    left half and the contact view on its right half. Positions are in mm on the glass, 0 at the centre of the contact
    view's first pixel.

    Args:
        n_frames: frames of the recording.
        frame_rate: frames per second.
        frames_before_trigger: number of frames with a negative time.
        frame_shape: rows and columns of a frame.
        mm_per_px: of the contact view.
        topography_to_contact: 2 x 3 affine map from pixels of the topography view to pixels of the contact view.
        texture: the skin; its centre is counted from the centre of the contact.
        contact_fraction: share of the apparent contact in which ridges touch.
        finger: semi-axes of the visible finger.
        camera: noise and bit depth.
        force_noise: standard deviation of a sample of the force sensors, white.
        force_drift: of the zero of both force sensors, N/s, from the trigger on.
    """

    n_frames: int = 300
    frame_rate: float = 300.0
    frames_before_trigger: int = 12
    frame_shape: tuple[int, int] = (512, 1280)
    mm_per_px: float = 0.0325
    topography_to_contact: tuple[tuple[float, float, float], tuple[float, float, float]] = (
        (1.01 * math.cos(math.radians(0.5)), -1.01 * math.sin(math.radians(0.5)), 3.4),
        (1.01 * math.sin(math.radians(0.5)), 1.01 * math.cos(math.radians(0.5)), -6.2),
    )
    texture: Skin = field(default_factory=lambda: RidgeTexture(centre=(0.4, -0.9)))
    contact_fraction: float = 0.5
    finger: tuple[float, float] = (7.6, 6.4)
    camera: Camera = field(default_factory=Camera)
    force_noise: float = 0.005
    force_drift: float = 0.0

    @property
    def times(self) -> Array:
        """Return the time of each frame in s from the trigger."""
        return (np.arange(self.n_frames) - self.frames_before_trigger) / self.frame_rate

    @property
    def views(self) -> dict[str, View]:
        """Return the rectangles of the "topography" and the "contact" view in a frame."""
        rows, columns = self.frame_shape
        return {
            "topography": View(rows=(0, rows), columns=(0, columns // 2)),
            "contact": View(rows=(0, rows), columns=(columns // 2, columns)),
        }

    @cached_property
    def truth(self) -> Truth:
        """Return the ground truth of this scene, to compare with results of a pipeline."""
        return Truth(self)

    def render(self, frame: int) -> NDArray[np.integer]:
        """Return a frame (H, W) with camera noise; it is deterministic and does not depend on the order of calls."""
        return self.camera.read_out(torch.from_numpy(self.render_clean(frame)), frame, defects=self.views["contact"])

    def render_clean(self, frame: int, dtype: torch.dtype = torch.float32) -> NDArray[np.floating]:
        """Return a frame (H, W) in unrounded grey levels of the camera, without noise."""
        if not 0 <= frame < self.n_frames:
            raise IndexError(f"frame {frame} is not in this scene: its frames are 0 to {self.n_frames - 1}")
        return self._picture(torch.tensor(self.progress(self.times)[frame], dtype=dtype), dtype)

    def empty_clean(self, dtype: torch.dtype = torch.float32) -> NDArray[np.floating]:
        """Return an image (H, W) of the glass without a finger, in unrounded grey levels without noise."""
        return self._picture(None, dtype)

    def empty(self, picture: int = 0) -> NDArray[np.integer]:
        """Return a noisy camera image (H, W) of the glass without a finger; the number `picture` selects the noise."""
        clean = torch.from_numpy(self.empty_clean())
        return self.camera.read_out(clean, EMPTY_PICTURES + picture, defects=self.views["contact"])

    def dark(self, picture: int = 0) -> NDArray[np.integer]:
        """Return a noisy camera image without light; the number `picture` selects the noise."""
        return self.camera.read_out(self.camera.expose(torch.zeros(self.frame_shape)), DARK_PICTURES + picture)

    def forces(self) -> tuple[Array, Array, Array, Array]:
        """Return noisy samples of the force sensors at 10 kHz from the first frame to the last: time in s, normal and
        tangential force in N, and the trigger in V, which rises at 0 s.
        """
        first, last = self.times[[0, -1]]
        time = np.arange(math.floor(first * FORCE_RATE), math.ceil(last * FORCE_RATE) + 1) / FORCE_RATE
        noise = np.random.default_rng(self.camera.seed).normal(scale=self.force_noise, size=(2, time.size))
        noise += self.force_drift * np.maximum(time, 0)
        normal, tangential = self.normal_force(time) + noise[0], self.tangential_force(time) + noise[1]
        return time, normal, tangential, np.where(time >= 0, 5.0, 0.0)

    #: Number of intervals of the progress in the search for the onset of contact; each contains one entry at most. A
    #: contact that grows faster than the skin spreads is entered once, as a point inside it stays inside.
    entry_steps = 1

    @abstractmethod
    def material(self, x: Tensor, y: Tensor, progress: Tensor) -> tuple[Tensor, Tensor]:
        """Return the material coordinates (mm), the positions in undeformed skin, of the skin that lies at positions
        (x, y) mm on the glass at a progress of the movement.
        """

    @abstractmethod
    def depth(self, x: Tensor, y: Tensor, progress: Tensor) -> Tensor:
        """Return how deep positions (x, y) mm lie inside the apparent contact at a progress of the movement, as a
        dimensionless number: positive inside, 0 on the edge, negative outside.
        """

    @abstractmethod
    def ellipse(self, progress: float) -> Ellipse | None:
        """Return the ellipse that bounds the apparent contact at `progress` (0 to 1); None without contact."""

    @abstractmethod
    def progress(self, time: Array) -> Array:
        """Return the progress of the movement, 0 to 1, at times in s."""

    @abstractmethod
    def normal_force(self, time: Array) -> Array:
        """Return the force normal to the glass at times in s, N."""

    @abstractmethod
    def tangential_force(self, time: Array) -> Array:
        """Return the force along the glass at times in s, N."""

    @property
    def contact_centre(self) -> tuple[float, float]:
        """Return the position (x, y) on the glass, mm, at which contact begins."""
        rows, columns = self.views["contact"].shape
        return 0.5 * (columns - 1) * self.mm_per_px + 0.15, 0.5 * (rows - 1) * self.mm_per_px + 0.1

    @cached_property
    def skin(self) -> Skin:
        """Return the texture of the skin as a function of material coordinates."""
        (x, y), (right, down) = self.contact_centre, self.texture.centre
        return replace(self.texture, centre=(x + right, y + down))

    def ridge_margin(self, x: Tensor, y: Tensor, depth: Tensor) -> Tensor:
        """Return the margin of the real contact in mm, positive where a ridge touches, at material coordinates (x, y)
        and at a distance `depth` (mm) from the edge of the apparent contact, positive inside.
        """
        return self.skin.ridge_margin(x, y, self.contact_fraction, depth)

    def _picture(self, progress: Tensor | None, dtype: torch.dtype) -> NDArray[np.floating]:
        """Return a noise-free frame that shows both views side by side at a progress of the movement, or without a
        finger for None.
        """
        topography_planes, contact_planes = _fixed_planes(self, dtype)
        views = self._topography(progress, *topography_planes), self._contact(progress, *contact_planes)
        return self.camera.expose(torch.cat(views, dim=1)).numpy()

    def _topography(self, progress: Tensor | None, x: Tensor, y: Tensor, grazing: Tensor, stray: Tensor) -> Tensor:
        if progress is None:
            return stray
        outline = Ellipse(self.contact_centre, self.finger)
        return optics.topography(self.skin, outline, *self.material(x, y, progress), grazing, stray)

    def _contact(self, progress: Tensor | None, x: Tensor, y: Tensor, bright_field: Tensor) -> Tensor:
        ellipse = None if progress is None else self.ellipse(float(progress))
        if progress is None or ellipse is None:
            return bright_field
        part = self._pixels_around(ellipse)
        x, y, glass = x[part], y[part], bright_field[part]
        depth = ellipse.distance(x, y)
        ridge_margin = self.ridge_margin(*self.material(x, y, progress), depth)
        view = bright_field.clone()
        view[part] = optics.contact(ridge_margin, depth, glass)
        return view

    def _pixels_around(self, ellipse: Ellipse) -> tuple[slice, slice]:
        """Return the slices of rows and columns of the contact view around a contact ellipse, outside which it shows
        only glass.
        """
        right, down = (
            slice(
                max(0, math.floor((middle - reach - optics.GLASS_FROM) / self.mm_per_px)),
                max(0, math.ceil((middle + reach + optics.GLASS_FROM) / self.mm_per_px) + 1),
            )
            for middle, reach in zip(ellipse.centre, ellipse.reach, strict=True)
        )
        return down, right


@lru_cache(maxsize=4)
def _fixed_planes(scene: SyntheticScene, dtype: torch.dtype) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Return the image planes (H, W) that all frames share: x and y in mm on the glass and the light levels at each
    pixel, first of the topography view, then of the contact view.

    They are computed in float64 and rounded once.
    """
    rows, columns = scene.views["contact"].shape
    size = columns * scene.mm_per_px, rows * scene.mm_per_px
    down, right = torch.meshgrid(
        torch.arange(rows, dtype=torch.float64), torch.arange(columns, dtype=torch.float64), indexing="ij"
    )
    (xx, xy, shift_x), (yx, yy, shift_y) = scene.topography_to_contact
    x, y = (xx * right + xy * down + shift_x) * scene.mm_per_px, (yx * right + yy * down + shift_y) * scene.mm_per_px
    topography = x, y, optics.grazing(x, y, *size), optics.stray(x, y, *size)
    x, y = right * scene.mm_per_px, down * scene.mm_per_px
    contact = x, y, optics.bright_field(x, y, *size)
    return tuple(plane.to(dtype) for plane in topography), tuple(plane.to(dtype) for plane in contact)
