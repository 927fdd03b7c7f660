"""Test cases for exported graphs: a synthetic press at the size of the recipe's views, and hard cases."""

from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from fingerflow.engines.check import spread
from fingerflow.engines.engine import ROWS
from fingerflow.export.build import OF_FEW, Graph, build
from fingerflow.export.portable import Portable
from fingerflow.export.recipe import GraphName, Recipe
from fingerflow.kernels.tracking_limits import WARP_GAUGE_PX
from fingerflow.ops.tracking.outliers import find_neighbours
from fingerflow.ops.tracking.templates import inverse_2x2
from fingerflow.synthetic import Camera, Press

_SHIPPED = (512, 640)  # px (rows, columns), size of the views of the default press
_BORDER = 0.6  # radius of the contact in the fields' test, as a share of half the view
_ENTERED = 0.1  # radius, as a share of half the view, within which points count as advected into the contact
_KEY, _FRAME = 180, 183  # frames of the press in which skin in contact moves and spreads: key frame and tracked frame


class Case(NamedTuple):
    """Test case: named inputs of graphs; `complete_inputs` adds inputs that other graphs compute."""

    name: str
    inputs: dict[str, Tensor]


def cases(recipe: Recipe, batch: int) -> list[Case]:
    """Create test cases for graphs, each a batch of `batch` recordings: a press with sub-pixel motion, frames without a
    finger, and invalid points.
    """
    size = (recipe.views.height, recipe.views.width)
    most = 2**recipe.views.bit_depth - 1
    kind = torch.uint8 if recipe.views.bit_depth == 8 else torch.uint16
    generator = torch.Generator().manual_seed(1)

    def view(values: Tensor) -> Tensor:
        return values.to(torch.int32).to(kind).expand(batch, 1, *size).contiguous()

    def flat(light: float) -> Tensor:
        noise = 0.008 * most * torch.randn(size, generator=generator)
        return view((light * most + noise).round().clamp(0, most))

    pictures, mm_per_px = _press(*size, recipe.views.bit_depth)
    points = torch.from_numpy(spread(*size, recipe.tracking.points)).float().expand(batch, -1, -1).contiguous()
    lost = points.clone()
    lost[:, ::5] = torch.nan
    lost[:, 1::5] = -3.0
    lost[:, 2::5] += 40.0
    radius = _radius(points, size)
    reference = mm_per_px * _reference(points, size)
    among = radius < _ENTERED
    press = {
        **{name: pictures[name].expand(batch, 1, *size).contiguous() for name in ("empty", "dark")},
        **{name: view(pictures[name]) for name in ("contact_view", "topography_view", "key_view")},
        "threshold": torch.full((batch,), 0.27),
        "mask": torch.ones(batch, 1, *size, dtype=torch.bool),
        "points": points,
        "prediction": points,
        "warp": _deformation_gradients(points),
        "inverse_warp": inverse_2x2(_deformation_gradients(points)),
        "reference": reference,
        "displacement": mm_per_px * points - reference,
        "queries": mm_per_px * points,
        "gauge_length": torch.full((batch,), recipe.fields.gauge_length_mm),
        "among": among,
        "gradient": torch.where(among[..., None, None], (_deformation_gradients(points) - torch.eye(2)) / 2, torch.nan),
        **{f"ellipse_{name}": one for name, one in _ellipse(batch, size, mm_per_px).items()},
    }
    noise = view((torch.rand(size, generator=generator) * most).round())
    hard = {"blank": flat(0.5), "black": flat(0.0), "saturated": flat(2.0), "noise": noise}
    return [
        Case("press", press),
        Case("lost and foreign points", {**press, "prediction": lost}),
        Case("points that are none", {**press, "points": lost}),
        *(
            Case(name, {**press, "contact_view": frame, "topography_view": frame, "key_view": frame})
            for name, frame in hard.items()
        ),
        Case("unknown threshold", {**press, "threshold": torch.full((batch,), torch.nan)}),
    ]


def complete_inputs(recipe: Recipe, case: Case) -> dict[str, Tensor]:
    """Return the inputs of a test case by name, completed by running, in torch, the graphs that compute the missing
    inputs.
    """
    known = dict(case.inputs)
    graphs = build(recipe)
    for name in ("light", "noise", "spline", "prepare"):
        known |= graphs[name].run(inputs_of(name, graphs[name], known))
    found = graphs["track"].run(known)
    known |= {"found": found["points"], "found_covariance": found["covariance"]}
    known["start"] = known["template_start"]
    known |= graphs["support"].run(known)
    names_of_neighbours = ("neighbour_number", "neighbour_offset", "neighbour_within")
    with torch.inference_mode(), Portable():
        known |= zip(names_of_neighbours, find_neighbours(known["start"], WARP_GAUGE_PX), strict=True)
        known["position_std"] = known["found_covariance"].diagonal(dim1=-2, dim2=-1).mean(-1).sqrt()
    return known


def inputs_of(name: GraphName, graph: Graph, known: dict[str, Tensor]) -> dict[str, Tensor]:
    """Return the inputs of one graph by name; graphs that run on the key frame, the one from which points are followed,
    get `key_view` as topography view.
    """
    source = known
    if name in ("noise", "detect", "spline", "prepare"):
        source = known | {"topography_view": known["key_view"]}
    few = OF_FEW.get(name, ())
    return {one: source[one][:, :ROWS] if one in few else source[one] for one in graph.inputs}


@lru_cache(maxsize=4)
def _press(height: int, width: int, bit_depth: int) -> tuple[dict[str, Tensor], float]:
    """Render the images (H, W) of the default synthetic press, by input name; also return the pixel size in mm.

    For smaller views the finger is scaled down.
    """
    scale = min(1.0, height / _SHIPPED[0], width / _SHIPPED[1])
    shipped = Press()
    press = Press(
        frame_shape=(height, 2 * width),
        semi_axes=(scale * shipped.semi_axes[0], scale * shipped.semi_axes[1]),
        finger=(scale * shipped.finger[0], scale * shipped.finger[1]),
        camera=Camera(bit_depth=bit_depth),
    )
    contact, topography = press.views["contact"], press.views["topography"]
    pictures = {
        "contact_view": contact.crop(press.render(_FRAME)),
        "topography_view": topography.crop(press.render(_FRAME)),
        "key_view": topography.crop(press.render(_KEY)),
        "empty": contact.crop(press.empty()),
        "dark": contact.crop(press.dark()),
    }
    return {name: torch.from_numpy(one.astype("float32")) for name, one in pictures.items()}, press.mm_per_px


def _radius(points: Tensor, size: tuple[int, int]) -> Tensor:
    """Return the elliptic radius (B, N) of points in a view of (height, width) px: 0 at the middle of the view, 1 at
    the middle of each side.
    """
    return torch.hypot(2 * points[..., 0] / size[1] - 1, 2 * points[..., 1] / size[0] - 1)


def _reference(points: Tensor, size: tuple[int, int]) -> Tensor:
    """Create the positions (B, N, 2) px at which test points first came into contact; NaN for points outside the
    contact.

    The contact reaches outer points last; since their onset, points have spread and turned by some per cent.
    """
    radius = _radius(points, size)[..., None]
    arm = points - torch.tensor([size[1] / 2, size[0] / 2])
    moved = (_BORDER - radius) * (0.2 * arm + 0.05 * torch.stack((-arm[..., 1], arm[..., 0]), dim=-1))
    return torch.where(radius < _BORDER - 0.05, points - moved, torch.nan)


def _deformation_gradients(points: Tensor) -> Tensor:
    """Create deformation gradients (B, N, 2, 2) at points: the identity plus a few per cent that vary from point to
    point.
    """
    x, y = points[..., 0] / 40, points[..., 1] / 40
    change = torch.stack((torch.sin(x), torch.cos(y), torch.sin(x + y), torch.cos(x - y)), dim=-1)
    result: Tensor = torch.eye(2) + 0.03 * change.unflatten(-1, (2, 2))
    return result


def _ellipse(batch: int, size: tuple[int, int], mm_per_px: float) -> dict[str, Tensor]:
    """Create a contact ellipse about the middle of the view, to test graphs of deformation: centre and semi-axes (B, 2)
    mm, and angle (B,) rad.
    """
    half = (mm_per_px / 2 * torch.tensor([size[1], size[0]], dtype=torch.float32)).expand(batch, -1)
    return {
        "center": half.contiguous(),
        "semi_axes": (_BORDER * half).contiguous(),
        "angle": torch.full((batch,), 0.1),
    }
