"""Contact of one frame with the threshold measured in it."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from fingerflow.ops.illumination import LEVEL_RANGE, levels_per_unit
from fingerflow.stream.background import levels, whole_level
from fingerflow.stream.contact import span
from fingerflow.stream.finite import finite
from fingerflow.stream.lattice_median import median_on_lattice
from fingerflow.stream.levels import LEVELS, median_level, otsu_classes
from fingerflow.stream.median_planes import majority
from fingerflow.stream.nearest_byte import nearest_byte
from fingerflow.stream.region import RegionStep, means_of_squares

# Contact takes at least a twentieth of the light; two halves of noise lie closer together (`graphs.ContactGraph`).
_LEAST_LIGHT_LOST = 0.05
_NOISE_RATIO = 6
# Of the region in which levels are counted where a lattice of them is: px between the pixels that make it, and cells.
_STEP = 2
_CELL = 8


class MeasuredContact(NamedTuple):
    """As `StreamContact`, and `threshold` (B,), the share of light lost above which a pixel touches; NaN, and nothing
    touches, without contact."""

    touching: Tensor
    real_area_px: Tensor
    gross_area_px: Tensor
    center: Tensor
    semi_axes: Tensor
    angle: Tensor
    threshold: Tensor


class MeasuredContactStep(nn.Module):
    """Levels of light lost, their median, Otsu's threshold, and the better one that it leads to.

    Otsu's threshold finds the gross region; half-way between the medians of its touching and its other pixels lies the
    threshold (`graphs.ContactGraph`).

    Args:
        median_px: odd side of the median.
        median_type: type of the levels in the median: uint8, or one that the runtime has minima of.
        lattice_px: step of the lattice of pixels that are counted; 1 for all of them.
        scatter: count by scattering (fast on a processor) rather than by a product of digits.
        cell_px: of the gross region (`RegionStep`).
    """

    def __init__(
        self,
        median_px: int = 3,
        median_type: torch.dtype = torch.uint8,
        lattice_px: int = 1,
        scatter: bool = True,
        precision: torch.dtype = torch.float32,
        cell_px: int = 4,
    ) -> None:
        super().__init__()
        self.median_px = median_px
        self.median_type = median_type
        self.lattice_px = lattice_px
        self.scatter = scatter
        self.precision = precision
        self.region = RegionStep(precision, cell_px)
        # Where few pixels are counted, few tell where to count them.
        self.step = 1 if lattice_px == 1 else _STEP
        self.first_region = self.region if lattice_px == 1 else RegionStep(precision, _CELL)

    def forward(self, contact_view: Tensor, gain: Tensor, offset: Tensor, valid: Tensor) -> MeasuredContact:
        """(B, 1, H, W) frames and the results of `BackgroundStep`."""
        own = self._levels(contact_view.to(self.precision), gain, offset)
        some = median_on_lattice(own, self.median_px, self.lattice_px)
        threshold = self._threshold(own, some, valid)
        if self.lattice_px == 1:
            above = self._above(some, threshold)
        else:
            above = majority(self._above(own, threshold), self.median_px)
        contact = span(self.region, torch.minimum(above, valid))
        return MeasuredContact(*contact[:-1], threshold=threshold)

    def _levels(self, counts: Tensor, gain: Tensor, offset: Tensor) -> Tensor:
        if self.median_type == torch.uint8 and counts.dtype == torch.float32:
            return nearest_byte(offset - counts * gain)
        return levels(counts, gain, offset).to(self.median_type)

    def _above(self, some: Tensor, threshold: Tensor) -> Tensor:
        """1 where a level lies above the threshold (B,), in uint8; nowhere above NaN."""
        limit = whole_level(threshold).reshape(-1, 1, 1, 1).to(self.median_type)
        return (some > limit).to(torch.uint8)

    def _threshold(self, own: Tensor, some: Tensor, valid: Tensor) -> Tensor:
        """Share of light lost (B,), of the levels of all pixels and the medians of the lattice."""
        low, high = LEVEL_RANGE
        scale = levels_per_unit(low, high)
        weight = valid[..., :: self.lattice_px, :: self.lattice_px]
        classes = otsu_classes(self._histogram(some, weight))
        otsu = classes.threshold / scale + low
        distance = (classes.upper - classes.lower) / scale
        least = (_NOISE_RATIO * classes.deviation / scale).clamp_min(_LEAST_LIGHT_LOST)
        apart = finite(otsu) & (classes.upper / scale + low > _LEAST_LIGHT_LOST) & (distance > least)
        first = torch.where(apart, otsu, torch.nan)
        if self.lattice_px == 1:
            touching = torch.minimum(self._above(some, first), valid)
        else:
            touching = majority(torch.minimum(self._above(own, first), valid), self.median_px, self.step)
        cells = means_of_squares(touching.to(self.precision), self.first_region.cell // self.step)
        gross = (self.first_region.of_cells(cells).excess > 0).to(valid.dtype)
        inside = self._on_lattice(gross, *valid.shape[-2:])
        both = self._histogram(some, torch.minimum(weight, inside))
        level = torch.arange(LEVELS, dtype=self.precision, device=both.device)
        ridges = both * (level > whole_level(first)[:, None])
        valleys = both - ridges
        # Contact without gaps has no valleys: the empty glass stands for them.
        valley = torch.where(valleys.sum(1) > 0, median_level(valleys), classes.lower)
        return torch.where(apart, (median_level(ridges) + valley) / 2 / scale + low, torch.nan)

    def _on_lattice(self, cells: Tensor, height: int, width: int) -> Tensor:
        """Cells of the region at the pixels of the lattice."""
        for axis, side in ((3, width), (2, height)):
            pixels = torch.arange(0, side, self.lattice_px, device=cells.device)
            cells = cells.index_select(axis, pixels // self.first_region.cell)
        return cells

    def _histogram(self, image: Tensor, weight: Tensor) -> Tensor:
        """Counts (B, 256) of the levels of pixels of weight 1, exact below 2^24."""
        flat, counted = image.flatten(1), weight.flatten(1).to(self.precision)
        if self.scatter:
            empty = torch.zeros((flat.shape[0], LEVELS), dtype=self.precision, device=flat.device)
            return empty.scatter_add(1, flat.to(torch.int64), counted)
        digits = torch.arange(16, dtype=self.precision, device=flat.device)
        values = flat.to(self.precision)
        tens = (values / 16).floor()
        ones = values - 16 * tens
        rows = (tens[:, None] == digits[:, None]).to(self.precision) * counted[:, None]
        columns = (ones[:, None] == digits[:, None]).to(self.precision)
        return (rows @ columns.transpose(1, 2)).flatten(1)
