"""Skin from an image of a fingerprint: a spline through its pixels, defined at every real-valued position."""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, TypeVar

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, spline_filter
from torch import Tensor

from fingerflow.errors import FingerflowError
from fingerflow.synthetic.grid_spline import cubic_weights
from fingerflow.synthetic.scenes import SyntheticScene

Plane = NDArray[np.float64]
Kind = TypeVar("Kind", bound=SyntheticScene)

MM_PER_INCH = 25.4
#: Resolution (dots per inch) of most fingerprint sensors.
DPI = 500.0
#: Plausible ridge distances of skin (mm), from a child's finger to a broad thumb with a margin.
RIDGE_DISTANCES = (0.25, 0.8)
#: Blur (px) of the image, so that its pixels and noise are not visible with a finer camera.
BLUR = 0.7
#: Width of the constant border around the image, in its pixels.
SURROUND = 8
#: Least darkness of a touching pixel relative to the glass, as a share of the contrast between glass and ridges.
LEAST = 0.35
#: Slope of the contact level (1/mm) below which the level gives no distance from the edge of a ridge.
LEAST_SLOPE = 1.0


class SkinPlanes(NamedTuple):
    """Coefficients of the splines through contrast and contact level of the skin in an image, and (rows, columns) of
    the image; the level is positive where the skin touches, and ridge and glass differ by 1 in it.
    """

    contrast: Tensor
    level: Tensor
    shape: tuple[int, int]


@dataclass(frozen=True)
class PictureTexture:
    """Skin from an image of a fingerprint, with dark touching ridges on bright glass as optical sensors deliver it.

    The image is corrected for uneven light and pressure within a ridge distance, blurred by 0.7 of its pixels and
    interpolated by a cubic spline, so grey level and contact are known everywhere and twice continuously
    differentiable. Ridges touch where they are darker than their surroundings, so gaps, pores, dirt and the share of
    the skin that touches are those of the image. Where the image is blank, and beyond it, the skin is smooth and never
    touches.

    Args:
        picture: any file that OpenCV reads.
        dpi: pixels of the image per inch.
        centre: position of the image's centre, mm.
        border: loss of contact level at the edge of the contact, as a share of the contrast from ridge to glass.
        border_width: distance (mm) from the edge over which that loss falls to 1/e.

    Raises:
        FingerflowError: the image cannot be read, has no ridges, or they are not those of skin at this resolution.
    """

    picture: Path
    dpi: float = DPI
    centre: tuple[float, float] = (0.0, 0.0)
    border: float = 0.15
    border_width: float = 0.5
    _planes: SkinPlanes = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_planes", _read_planes(Path(self.picture), self.dpi))

    @property
    def mm_per_px(self) -> float:
        """Return the pixel size of the image, mm."""
        return MM_PER_INCH / self.dpi

    @property
    def size(self) -> tuple[float, float]:
        """Return width and height of the image, mm, between the centres of its outermost pixels."""
        rows, columns = self._planes.shape
        return (columns - 1) * self.mm_per_px, (rows - 1) * self.mm_per_px

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        """Return the skin's contrast, within [-1, 1] and bright on ridges, at material positions (x, y), in mm."""
        value, _, _ = _spline(self._planes.contrast, *self._pixels(x, y))
        return value.clamp_(-1, 1)

    def ridge_margin(self, x: Tensor, y: Tensor, share: float, depth: Tensor) -> Tensor:
        """Return the signed distance, mm, from positions (x, y) to the edge of the part of a ridge that touches the
        glass, positive inside; `depth` is the distance (mm) to the contact border, and ``share`` is ignored.
        """
        value, by_column, by_row = _spline(self._planes.level, *self._pixels(x, y))
        slope = torch.sqrt((by_column.square() + by_row.square()) / self.mm_per_px**2 + LEAST_SLOPE**2)
        loose = torch.exp(depth.clamp(min=-self.border_width) / -self.border_width)
        return (value - self.border * loose) / slope

    def _pixels(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Convert material positions (x, y), mm, to column and row, px, in the fingerprint image with added border."""
        rows, columns = self._planes.shape
        column = (x - self.centre[0]) / self.mm_per_px + 0.5 * (columns - 1) + SURROUND
        row = (y - self.centre[1]) / self.mm_per_px + 0.5 * (rows - 1) + SURROUND
        return column, row


def scene_of_print(scene_class: type[Kind], picture: Path, dpi: float = DPI) -> Kind:
    """Return a press or slide (`scene_class`) of the finger whose fingerprint is in an image, with the contact as
    close as possible to the centre of the print.

    Raises:
        FingerflowError: as `PictureTexture`, or the image is smaller than the skin that comes into contact.
    """
    texture = PictureTexture(Path(picture), dpi)
    plain = scene_class()
    # Skin under the edge of the contact: at the start and, if the finger travels, where skin enters at the front.
    edges = []
    for frame in (*range(0, plain.n_frames, 20), plain.n_frames - 1):
        if (ellipse := plain.truth.ellipse(frame)) is not None:
            edges.append(plain.truth.material(ellipse.edge(64), frame))
    outline = np.concatenate(edges) - plain.contact_centre
    low, high = outline.min(axis=0), outline.max(axis=0)
    half = np.array(texture.size) / 2
    if (high - low > 2 * half).any():
        width, height = high - low
        raise FingerflowError(
            f"{picture} shows {texture.size[0]:.1f} x {texture.size[1]:.1f} mm at {dpi:g} dpi, and the contact needs "
            f"{width:.1f} x {height:.1f} mm of skin; give the right resolution (--dpi) or a larger picture"
        )
    # Centroid of the touching ridges, relative to the centre of the image.
    rows, columns = texture._planes.shape
    down = (torch.arange(rows, dtype=torch.float64) - 0.5 * (rows - 1)) * texture.mm_per_px
    right = (torch.arange(columns, dtype=torch.float64) - 0.5 * (columns - 1)) * texture.mm_per_px
    y, x = torch.meshgrid(down, right, indexing="ij")
    touching = texture.ridge_margin(x, y, 0.5, torch.full_like(x, 9.0)) > 0
    middle = np.array([float(x[touching].mean()), float(y[touching].mean())])
    centre = np.clip(-middle, high - half, low + half).tolist()
    return replace(plain, texture=replace(texture, centre=tuple(centre)))


@lru_cache(maxsize=4)
def _read_planes(picture: Path, dpi: float) -> SkinPlanes:
    """Read an image of a fingerprint; raise FingerflowError as `PictureTexture`."""
    grey = cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
    if grey is None:
        reason = "cannot be read as a picture" if picture.exists() else "does not exist"
        raise FingerflowError(f"{picture} {reason}; give a PNG, TIFF, BMP or JPEG of a fingerprint")
    if not 50 <= dpi <= 10_000:
        raise FingerflowError(f"dpi is {dpi:g}; a picture that shows ridges has 50 to 10,000 pixels an inch, most 500")
    if min(grey.shape) < 64:
        raise FingerflowError(f"{picture} has {grey.shape[0]} x {grey.shape[1]} pixels; 64 x 64 are the least")
    plane = gaussian_filter(grey.astype(np.float64), BLUR)
    distance = _ridge_distance(plane, picture) * MM_PER_INCH / dpi
    if not RIDGE_DISTANCES[0] <= distance <= RIDGE_DISTANCES[1]:
        raise FingerflowError(
            f"{picture}: its ridges are {distance:.2f} mm apart at {dpi:g} dpi, those of skin "
            f"{RIDGE_DISTANCES[0]} to {RIDGE_DISTANCES[1]} mm; give the picture's resolution (--dpi)"
        )
    period = distance * dpi / MM_PER_INCH
    mean = gaussian_filter(plane, 0.75 * period)
    spread = np.sqrt(gaussian_filter((plane - mean) ** 2, 1.5 * period))
    # The brightest grey level within one ridge distance shows glass or a valley.
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * round(period) + 1,) * 2)
    glass = gaussian_filter(np.asarray(cv2.dilate(plane, around), dtype=np.float64), 2 * period)
    dark = np.quantile(plane, 0.03)
    contrast = np.maximum(glass - dark, 0.2 * (glass.max() - dark) + 1e-9)
    touching = (np.minimum(mean, glass - LEAST * contrast) - plane) / contrast
    # The amplitude of a sine is 1.4 times its standard deviation; the added constant attenuates noise in blank parts.
    full = np.quantile(spread, 0.8)
    skin = np.tanh((mean - plane) / (1.6 * spread + 0.3 * full)) * np.clip(spread / (0.4 * full), 0, 1)
    skin *= _edge_weights(plane.shape[0], period)[:, None] * _edge_weights(plane.shape[1], period)
    return SkinPlanes(_coefficients(skin, 0.0), _coefficients(touching, -LEAST), grey.shape)


def _edge_weights(count: int, period: float) -> Plane:
    """Return taper weights (count,) for a row of pixels, which rise from 0 at both ends to 1 over one ridge distance,
    `period` px.
    """
    inward = np.minimum(np.arange(count), np.arange(count)[::-1])
    return 0.5 - 0.5 * np.cos(np.pi * np.minimum(inward / period, 1))


def _ridge_distance(plane: Plane, picture: Path) -> float:
    """Return the mean distance between ridges in a fingerprint image, 4 to 40 px: the wavelength at the peak of the
    radial power spectrum.
    """
    flat = plane - gaussian_filter(plane, 12.0)
    if flat.std() < 1e-3 * max(np.ptp(plane), 1.0):
        raise FingerflowError(f"{picture} shows no ridges; give a picture of a fingerprint")
    window = np.hanning(plane.shape[0])[:, None] * np.hanning(plane.shape[1])
    power = np.abs(np.fft.rfft2(flat * window)) ** 2
    frequency = np.hypot(np.fft.fftfreq(plane.shape[0])[:, None], np.fft.rfftfreq(plane.shape[1]))
    edges = np.linspace(1 / 40, 1 / 4, 46)
    peak = int(np.argmax(np.histogram(frequency, edges, weights=power)[0]))
    return float(2 / (edges[peak] + edges[peak + 1]))


def _coefficients(plane: Plane, outside: float) -> Tensor:
    """Return the coefficients of a cubic spline through an image that is padded with a border of the grey level
    `outside`.
    """
    return torch.from_numpy(spline_filter(np.pad(plane, SURROUND, constant_values=outside), order=3, mode="mirror"))


def _spline(coefficients: Tensor, column: Tensor, row: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return a cubic spline's value at positions in px and its derivatives by column and row (1/px).

    Beyond the spline its value at the border is used.
    """
    rows, columns = coefficients.shape
    flat = coefficients.to(column.dtype).flatten()
    column, row = column.clamp(1, columns - 2 - 1e-3), row.clamp(1, rows - 2 - 1e-3)
    left, top = torch.floor(column), torch.floor(row)
    across, across_slope = cubic_weights(column - left)
    down, down_slope = cubic_weights(row - top)
    start = (top.long() - 1) * columns + left.long() - 1
    value, by_column, by_row = torch.zeros_like(column), torch.zeros_like(column), torch.zeros_like(column)
    for i in range(4):
        line, slope = torch.zeros_like(column), torch.zeros_like(column)
        for j in range(4):
            taken = torch.take(flat, start + (i * columns + j))
            line, slope = line.addcmul_(taken, across[j]), slope.addcmul_(taken, across_slope[j])
        value.addcmul_(line, down[i])
        by_column.addcmul_(slope, down[i])
        by_row.addcmul_(line, down_slope[i])
    return value, by_column, by_row
