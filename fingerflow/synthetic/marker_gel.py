"""Synthetic soft sensor: a gel with printed markers and a camera; an object presses, drags, slips and lifts off."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fingerflow.errors import FingerflowError
from fingerflow.schema.scene_template import gel_scene_text
from fingerflow.synthetic.camera import Camera

Array = NDArray[np.float64]
_SUPERSAMPLED = 2  # positions per pixel along each axis
_INVERTED = 1e-3  # px, last step of the fixed-point iteration; its error is no larger for gradients up to 1/2


@dataclass(frozen=True, kw_only=True)
class MarkerGel:
    """Synthetic gel: a lattice of dark discs on an elastic surface that an object deforms.

    Lengths are in px of the frame, places (x, y).

    Time course, in shares of the recording: at rest until 0.15. Until 0.3 the object presses, which spreads the gel by
    `dilation`. Until 0.6 it drags the gel by `shear`, while its rim slips from 0.45 on. At 0.7 it slips as a whole:
    from one frame to the next the gel keeps `kept` of its shear. At 0.85 the object is gone and the gel is at rest.

    A point X of the surface at rest is displaced by u = (shear s(t) m(r, t) + dilation p(t) (X - c)) exp(-r^2 / 2 b^2)
    with r its distance from the object's centre c, b the `reach`, and m from 1 in the stick region to 1 - `lag` at its
    rim. The function is exact and is inverted at four points per pixel. Light falls from three sides, one per colour,
    so pressure darkens one side and brightens the other.
    """

    n_frames: int = 48
    frame_rate: float = 25.0
    frame_shape: tuple[int, int] = (240, 320)
    spacing: float = 31.0  # distance between markers of the lattice
    radius: float = 5.0  # radius of a marker
    jitter: float = 0.6  # standard deviation of the markers' positions about the lattice
    contact: tuple[float, float] = (190.0, 120.0)  # centre of the object
    object_radius: float = 60.0
    reach: float = 75.0  # standard deviation of the Gaussian by which the displacement falls with distance
    shear: tuple[float, float] = (-34.0, 21.0)  # displacement at the end of the drag
    kept: float = 0.35  # share of the shear that remains after gross slip
    dilation: float = 0.12  # displacement gradient of the spreading
    lag: float = 0.35  # share of the shear that the rim of the contact loses by partial slip
    tilt: float = 0.3  # largest relative change of light due to pressure
    exposure: float = 0.85  # gain of the camera while the object touches
    seed: int = 0  # seed of the random jitter
    camera: Camera = field(default_factory=lambda: Camera(noise=1.5, salt_and_pepper=0.0))

    @cached_property
    def markers(self) -> Array:
        """Return marker positions (N, 2) px at rest, including those outside the frame that may move into it."""
        height, width = self.frame_shape
        columns, rows = (np.arange(-2, int(size / self.spacing) + 3) for size in (width, height))
        lattice = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2) * self.spacing + self.spacing / 3
        return np.asarray(lattice + np.random.default_rng(self.seed).normal(0, self.jitter, lattice.shape))

    def pressed(self, frame: int) -> float:
        """Return the indentation depth in a frame as a fraction (0 to 1) of the largest depth."""
        return float(np.interp(self._share(frame), (0.15, 0.3, 0.7, 0.85), (0, 1, 1, 0)))

    def sheared(self, frame: int) -> float:
        """Return the shear of the gel in a frame as a fraction (0 to 1) of the largest shear, `shear`."""
        share = self._share(frame)
        if share >= 0.7:
            return float(np.interp(share, (0.7, 0.85), (self.kept, 0)))
        return float(np.interp(share, (0.3, 0.6), (0, 1)))

    @property
    def slip_frame(self) -> int:
        """Return the index of the first frame in which the whole contact slips (gross slip)."""
        return next(frame for frame in range(self.n_frames) if self._share(frame) >= 0.7)

    def lagging(self, frame: int) -> float:
        """Return the progress of partial slip at the edge of the contact in a frame, from 0 (no slip) to 1 (the rim has
        lost the share `lag` of the shear).
        """
        return float(np.interp(self._share(frame), (0.45, 0.6), (0, 1)))

    def displacement(self, places: Array, frame: int) -> Array:
        """Return the displacement (..., 2) px, in a frame, of surface points with rest positions (..., 2) px."""
        off = places - np.asarray(self.contact)
        r = np.linalg.norm(off, axis=-1, keepdims=True)
        rim = np.clip((r - 0.4 * self.object_radius) / (0.6 * self.object_radius), 0, 1)
        stuck = 1 - self.lag * self.lagging(frame) * rim * rim * (3 - 2 * rim)
        shear = self.sheared(frame) * stuck * np.asarray(self.shear)
        spread = self.dilation * self.pressed(frame) * off
        return np.asarray((shear + spread) * np.exp(-(r**2) / (2 * self.reach**2)))

    def positions(self, frame: int) -> Array:
        """Return the positions (N, 2) px of the markers in a frame."""
        return self.markers + self.displacement(self.markers, frame)

    def picture(self, frame: int) -> NDArray[np.uint8]:
        """Return the colour image (H, W, 3) of a frame in red, green, blue."""
        height, width = self.frame_shape
        fine = (np.arange(_SUPERSAMPLED) + 0.5) / _SUPERSAMPLED - 0.5
        x, y = ((np.arange(size)[:, None] + fine).ravel() for size in (width, height))
        place = np.stack(np.meshgrid(x, y), axis=-1)
        rest, before = place - self.displacement(place, frame), place
        while np.abs(rest - before).max() > _INVERTED:
            rest, before = place - self.displacement(rest, frame), rest
        distance = cKDTree(self.markers).query(rest, distance_upper_bound=3 * self.radius)[0]
        ink = 1 / (1 + np.exp(np.clip((distance - self.radius) / 0.8, -50, 50)))
        off = (place - np.asarray(self.contact)) / self.object_radius
        slope = off * np.exp(-((off**2).sum(-1, keepdims=True) ** 2))
        pressed = self.pressed(frame)
        gain = 1 + (self.exposure - 1) * pressed
        colours = []
        for k, turn in enumerate((0.0, 2.1, 4.2)):
            side = (place @ (np.cos(turn), np.sin(turn))) / width
            light = 105 + 35 * side + 170 * self.tilt * pressed * (slope @ (np.cos(turn), np.sin(turn)))
            shown = gain * light * (1 - 0.75 * ink)
            shown = shown.reshape(height, _SUPERSAMPLED, width, _SUPERSAMPLED).mean((1, 3))
            clean = self.camera.expose(torch.from_numpy(shown.astype(np.float32)))
            colours.append(self.camera.read_out(clean, 3 * frame + k))
        return np.stack(colours, axis=-1).astype(np.uint8)

    def _share(self, frame: int) -> float:
        return frame / max(self.n_frames - 1, 1)


def write_gel_recording(folder: Path, gel: MarkerGel, mm_per_px: float = 0.06) -> Path:
    """Write a recording of the gel, as compressed colour video, with its scene.toml; return the path of the latter.

    Raises FingerflowError if the folder exists already or the video cannot be written.
    """
    if folder.exists():
        raise FingerflowError(f"{folder} exists already; remove it or name another folder for the synthetic recording")
    folder.mkdir(parents=True)
    height, width = gel.frame_shape
    video, scene = folder / "frames.avi", folder / "scene.toml"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), gel.frame_rate, (width, height))
    if not writer.isOpened():
        raise FingerflowError(f"{video}: OpenCV cannot write Motion JPEG here; install opencv with its video writers")
    for frame in range(gel.n_frames):
        writer.write(cv2.cvtColor(gel.picture(frame), cv2.COLOR_RGB2BGR))
    writer.release()
    scene.write_text(gel_scene_text(video.name, gel.frame_shape, mm_per_px), encoding="utf-8")
    return scene
