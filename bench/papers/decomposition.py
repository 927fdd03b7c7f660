"""Figure S6 of Willemet et al. 2021: a displacement field decomposed into constant, divergence, curl and two shears."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from numpy.typing import ArrayLike, NDArray

from fingerflow.plot.axes_style import INK, RED, finished
from fingerflow.plot.captions import describe
from fingerflow.schema.variables import VARIABLES

Values = NDArray[np.float64]
PARTS = ("field", "constant", "divergence", "curl", "shear along axes", "shear along diagonals", "rest")


@dataclass(frozen=True)
class Decomposition:
    """Displacement field of P points, split into the parts named by PARTS (constant, divergence, curl, two shears,
    rest); NaN at points with unknown displacement.

    All parts but the first, the field, add up to it. With divergence d, curl c (rad) and shears s, t the gradient of
    all but the rest is [[d + s, t - c], [t + c, d - s]] / 2, dimensionless.
    """

    points: Values  # (P, 2) mm
    parts: dict[str, Values]  # displacement (P, 2) mm of each part by its name
    constant: tuple[float, float]  # mm, mean displacement
    divergence: float
    curl: float
    shear: tuple[float, float]


def decompose(points: ArrayLike, displacement: ArrayLike) -> Decomposition:
    """Split a displacement field into constant, divergence, curl, two shears (from a linear fit) and residual.

    The fit is about the centre of the points.

    Args:
        points: (P, 2) mm, reference positions x and y, three or more that are not on a line.
        displacement: (P, 2) mm; points with NaN in either are left out of the fit.
    """
    places, moved = np.asarray(points, dtype=np.float64), np.asarray(displacement, dtype=np.float64)
    known = np.isfinite(places).all(1) & np.isfinite(moved).all(1)
    apart = places - places[known].mean(0)
    columns = np.column_stack((np.ones(len(apart)), apart))
    constant, *slopes = np.linalg.lstsq(columns[known], moved[known], rcond=None)[0]
    (ux, vx), (uy, vy) = (tuple(map(float, row)) for row in slopes)
    x, y = apart.T
    zero = 0 * x
    parts = {
        "field": moved,
        "constant": zero[:, None] + constant,
        "divergence": (ux + vy) / 2 * np.stack((x, y), 1),
        "curl": (vx - uy) / 2 * np.stack((-y, x), 1),
        "shear along axes": (ux - vy) / 2 * np.stack((x, -y), 1),
        "shear along diagonals": (uy + vx) / 2 * np.stack((y, x), 1),
    }
    parts["rest"] = moved - sum(parts[name] for name in PARTS[1:-1])
    return Decomposition(places, parts, (float(constant[0]), float(constant[1])), ux + vy, vx - uy, (ux - vy, uy + vx))


def draw_decomposition(part: SubFigure, found: Decomposition) -> None:
    """Draw figure S6: the displacement field and each of its parts as arrows, all at the same scale."""

    def amount(variable: str, value: float) -> str:
        one = VARIABLES[variable]
        return f"{one.shown_values(value):z.{one.shown_unit.decimals}f} {one.shown_unit.name}"

    rest = float(np.nanmedian(np.linalg.norm(found.parts["rest"], axis=1)))
    amounts = {
        "field": "",
        "constant": amount("displacement", float(np.hypot(*found.constant))),
        "divergence": amount("divergence", found.divergence),
        "curl": amount("curl", found.curl),
        "shear along axes": amount("shear", found.shear[0]),
        "shear along diagonals": amount("shear", found.shear[1]),
        "rest": f"{amount('displacement', rest)} in the median",
    }
    scale = _arrow_scale(found)
    grid: list[Axes] = list(part.subplots(2, 4, sharex=True, sharey=True).flat)
    axes = grid[: len(PARTS)]
    grid[-1].set_axis_off()
    for one, (name, said) in zip(axes, amounts.items(), strict=True):
        arrows = found.parts[name]
        shown = np.isfinite(arrows).all(1) & np.isfinite(found.points).all(1)
        one.quiver(
            *found.points[shown].T, *(scale * arrows[shown].T), angles="xy", scale_units="xy", scale=1,
            color=RED if name == "rest" else INK, width=0.006,
        )  # fmt: skip
        one.set(aspect="equal", title=f"{name}\n{said}" if said else f"{name}\narrows {scale:g} ×")
        one.margins(0.15)
        finished(one)
    known = int((np.isfinite(found.parts["field"]).all(1) & np.isfinite(found.points).all(1)).sum())
    describe(
        axes[0],
        "Displacement of the skin (field) and its parts by a least-squares fit that is linear in the position: "
        f"constant, divergence, curl, two shears and the rest, which add up to it. All arrows are drawn {scale:g} "
        f"times as long as they are. n = {known} points.",
    )
    axes[0].invert_yaxis()  # the axes share their limits, so this inverts all of them
    axes[3].tick_params(labelbottom=True)
    part.supxlabel("mm")
    part.supylabel("mm")


def _arrow_scale(found: Decomposition) -> float:
    """Return the factor, to one digit, by which displacement arrows are lengthened so that the 0.95 quantile of their
    lengths is a sixth of the field's width.
    """
    length = np.linalg.norm(found.parts["field"], axis=1)
    wide = float(np.max(np.nanmax(found.points, axis=0) - np.nanmin(found.points, axis=0)))
    long = float(np.nanquantile(length, 0.95))
    return float(f"{wide / 6 / long:.1g}") if long > 0 else 1.0
