"""The region that micro-junctions span, on cells of 4 or 8 px, with soft borders."""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

_BOX = 20  # px, two ridges and a little more
_BLOCK = 32  # px, a side of a block in which a component is followed
_LEAST_DENSITY = 0.2  # share of a contact that touches at least, as in `graphs.ContactGraph`


class Region(NamedTuple):
    """Gross contact of B frames.

    `excess` (B, 1, h, w): density of the junctions over its limit, positive inside the region and smooth across its
    border; of cells of c px, (i, j) stands for pixel (c j + (c - 1) / 2, c i + (c - 1) / 2). Area of the touching
    pixels and of the region (B,) px, centre and semi axes (B, 2) px, angle (B,) rad.
    """

    excess: Tensor
    real_area_px: Tensor
    area_px: Tensor
    center: Tensor
    semi_axes: Tensor
    angle: Tensor


class RegionStep(nn.Module):
    """As `ops.dense_region`, at a sixteenth of the places or less.

    The density of junctions is smooth over 20 px, so cells of 4 px lose nothing of it, and cells of 8 px little. Where
    its border crosses a cell, the cell counts by the part that lies inside, from the density's slope. Holes are filled
    where the region lies on all four sides. Of several components the one around the densest place counts; they are
    told apart on blocks of 32 px.

    Args:
        cell: px, a divisor of 32.
    """

    def __init__(self, precision: torch.dtype = torch.float32, cell: int = 4) -> None:
        super().__init__()
        self.precision = precision
        self.cell = cell

    def forward(self, touching: Tensor) -> Region:
        """(B, 1, H, W) of 0 and 1 in any type."""
        return self.of_cells(means_of_squares(touching.to(self.precision), self.cell))

    def of_cells(self, cells: Tensor) -> Region:
        """(B, 1, h, w) shares of each cell that touch."""
        cell = self.cell
        density = _smooth(cells, cell)
        inside = (density > 0.25).to(self.precision)
        for _ in range(2):
            inside = (density > _share(cells, inside) / 2).to(self.precision)
        # At a border that is curved outwards the density of the region itself is below one half.
        own = _smooth(inside, cell)
        around = functional.avg_pool2d(inside, 3, 1, 1)
        border = ((around - 0.5).abs() < 0.45).to(self.precision)
        level = ((own * border).sum((2, 3), keepdim=True) / border.sum((2, 3), keepdim=True).clamp_min(1)).clamp(
            0.25, 0.5
        )
        limit = _share(cells, inside) * level
        limit = _share(cells, (density > limit).to(self.precision)) * level
        above = density - limit
        inside = (above > 0).to(self.precision)
        filled = _enclosed(_main_component(inside, density, _BLOCK // cell))
        # The border cells, in which the region ends, count in part, also those just outside.
        near = functional.max_pool2d(filled, 3, 1, 1)
        part = (above / _slope(density).clamp_min(1e-6) + 0.5).clamp(0, 1)
        hole = torch.clamp_min(filled - inside, 0)
        # By extremes and products, which runtimes do several times as fast as choices: in a hole the density does not
        # exceed the limit, elsewhere it is not negative.
        coverage = torch.maximum(part * near, hole)
        excess = torch.maximum(density * near - limit, (2 * hole - 1) * limit)
        return Region(excess, cells.sum((1, 2, 3)) * cell**2, *_moments(coverage, cell))


def means_of_squares(image: Tensor, side: int) -> Tensor:
    """Means (B, 1, h, w) of squares of `side` px, zeros beyond the frame."""
    height, width = image.shape[-2:]
    if height % side or width % side:
        image = functional.pad(image, (0, -width % side, 0, -height % side))
    # Down first, in whole lines: half the time of a pooling.
    lines = image.unflatten(2, (-1, side)).sum(3)
    return lines.unflatten(3, (-1, side)).sum(4) / side**2


def _smooth(cells: Tensor, cell: int) -> Tensor:
    """Three box means; nothing touches beyond the frame."""
    down, along = (_boxes(side, _BOX / cell).to(cells) for side in cells.shape[-2:])
    return down @ cells @ along


def _boxes(side: int, width: float) -> Tensor:
    """(side, side): three box means of a line, over `width` places; those at its ends count in part."""
    place = torch.arange(side, dtype=torch.float64)
    box = ((width + 1) / 2 - (place[:, None] - place).abs()).clamp(0, 1) / width
    return box @ box @ box


def _share(cells: Tensor, inside: Tensor) -> Tensor:
    """Share (B, 1, 1, 1) of the region that touches."""
    count = inside.sum((2, 3), keepdim=True).clamp_min(1)
    return ((cells * inside).sum((2, 3), keepdim=True) / count).clamp(_LEAST_DENSITY, 1.0)


def _slope(density: Tensor) -> Tensor:
    """Length of the density's gradient, a cell: half the difference of two neighbours, zeros beyond the frame."""
    along, down = functional.pad(density, (1, 1)), functional.pad(density, (0, 0, 1, 1))
    x, y = along[..., 2:] - along[..., :-2], down[..., 2:, :] - down[..., :-2, :]
    return ((x * x + y * y) / 4 + 1e-12).sqrt()


def _main_component(inside: Tensor, density: Tensor, block: int) -> Tensor:
    """The cells connected to the densest one, by blocks of so many a side: dilated step by step, as often as the longer
    side has blocks."""
    height, width = inside.shape[-2:]
    fit = (0, -width % block, 0, -height % block)
    dense = inside * density
    if any(fit):
        inside, dense = functional.pad(inside, fit), functional.pad(dense, fit)
    blocks, densest = (functional.max_pool2d(cells, block) for cells in (inside, dense))
    reached = (densest >= densest.amax((2, 3), keepdim=True)).to(inside.dtype) * blocks
    for _ in range(max(blocks.shape[-2:])):
        reached = torch.minimum(functional.max_pool2d(reached, 3, 1, 1), blocks)
    return (inside * enlarge(reached, block))[..., :height, :width]


def enlarge(cells: Tensor, times: int) -> Tensor:
    """Every cell as a square of `times` x `times`."""
    return functional.interpolate(cells, scale_factor=times, mode="nearest")


def _enclosed(inside: Tensor) -> Tensor:
    """1 where the region lies to the left and right, above and below, or at the place itself."""
    between = []
    for axis in (2, 3):
        side = inside.shape[axis]
        place = torch.arange(1, side + 1, dtype=inside.dtype, device=inside.device)
        place = place[:, None] if axis == 2 else place
        last = (inside * place).amax(axis, keepdim=True)
        first = (side + 1) - (inside * ((side + 1) - place)).amax(axis, keepdim=True)
        between.append((place >= first) & (place <= last))
    return (between[0] & between[1]).to(inside.dtype)


def _moments(coverage: Tensor, cell: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Area, centre, semi axes and angle of the ellipse with the same moments (`ops.fit_ellipse`), px."""
    # About the middle of the frame, in cells, where float32 holds their squares.
    powers = []
    middles = []
    for count in coverage.shape[-2:]:
        place = torch.arange(count, dtype=coverage.dtype, device=coverage.device) - (count - 1) / 2
        powers.append(torch.stack((torch.ones_like(place), place, place * place)))
        middles.append((count - 1) / 2)
    moments = powers[0] @ coverage[:, 0] @ powers[1].T  # (B, 3, 3) by powers of y and x
    mass = moments[:, 0, :1]
    some = mass > 0.5
    moments = moments / torch.where(some, mass, 1.0)[..., None]
    mean = torch.cat((moments[:, 0, 1:2], moments[:, 1, :1]), dim=1)
    square = torch.cat((moments[:, 0, 2:], moments[:, 2, :1]), dim=1) - mean * mean
    mixed = moments[:, 1, 1:2] - mean[:, :1] * mean[:, 1:]
    # The places within a cell vary themselves, by (cell^2 - 1) / 12 px^2 if they are pixel centres.
    variance = square * cell**2 + (cell**2 - 1) / 12
    middle, half = variance.mean(1, keepdim=True), (square[:, :1] - square[:, 1:]) * (cell**2 / 2)
    mixed = mixed * cell**2
    spread = (half * half + mixed * mixed).sqrt()
    axes = 2 * torch.cat((middle + spread, (middle - spread).clamp_min(0)), dim=1).sqrt()
    angle = torch.atan2(mixed, half) / 2
    center = (mean + torch.tensor(middles[::-1], dtype=mean.dtype, device=mean.device)) * cell + (cell - 1) / 2
    return (
        torch.where(some, mass * cell**2, 0.0).squeeze(1),
        torch.where(some, center, torch.nan),
        torch.where(some, axes, torch.nan),
        torch.where(some, angle, torch.nan).squeeze(1),
    )
