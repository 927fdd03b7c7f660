"""Tests of rules that every public op keeps, with the inputs of tests/embedded.py: its Convention is true of dtype and
NaN, half precision is rounded float32, empty batches pass, derivatives are right, wrong arguments are refused.

A new op needs an entry in `OF_NAN` and `REFUSED`. Its own tests show axes, sign, pixel centre and border against truth.
"""

import inspect
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from fingerflow import ops
from fingerflow.kernels.result_records import FrameEllipse
from fingerflow.ops.contact.apparent_contact import apparent_contact
from fingerflow.ops.contact.otsu import histogram
from fingerflow.ops.contact.real_contact_mask import real_contact_mask
from fingerflow.ops.fields.area_medians import area_medians
from fingerflow.ops.fields.rigid_motion import rigid_residual
from fingerflow.ops.fields.strain import principal_strains
from fingerflow.ops.fields.strain_uncertainty import field_std
from fingerflow.ops.filters.noise import estimate_noise
from fingerflow.ops.filters.quantile import frame_quantile
from fingerflow.ops.tracking.contrast import subtract_background, unsharp_mask
from fingerflow.ops.tracking.corners import corner_response
from tests.embedded import CASES, HEIGHT, WIDTH, scene, tensors_of

EVERY_OP = pytest.mark.parametrize("name", ops.__all__)
ENTRIES = ["axes", "sign", "pixel centre", "dtype", "NaN", "border"]


#: Which inputs of an op are images or numbers whose dtype counts.
FLOATING = {
    "dense_flow": (0, 1),
    "local_gradients": (0, 1),
    "normalize_illumination": (0, 1),
    "scattered_to_grid": (0, 1),
    "track_points": (0, 1, 2),
    "triangle_gradients": (0, 2),
}


#: dtype of the result as a function of the dtypes of the inputs that are images or numbers.
DTYPES: dict[str, Callable[..., torch.dtype]] = {
    "that of the input.": lambda *given: given[0],
    "widest of the inputs.": lambda *given: max(given, key=lambda dtype: dtype.itemsize),
    "widest of points and values, at least float32.": lambda *given: max(
        torch.float32, *given, key=lambda dtype: dtype.itemsize
    ),
    "float32, or float64 if an input is.": lambda *given: torch.float64 if torch.float64 in given else torch.float32,
    "float32, or float64 if the frames are.": lambda first, *_: (
        torch.float64 if first == torch.float64 else torch.float32
    ),
    "float64.": lambda *given: torch.float64,
}


def inputs_of(name: str) -> list[Any]:
    return list(CASES["otsu_threshold - floating" if name == "otsu_threshold" else name].inputs)


def results_of(name: str, inputs: list[Any], dtypes: list[torch.dtype]) -> list[Tensor]:
    """Return the tensors of the result of an op, its images and numbers converted to these dtypes."""
    case = CASES["otsu_threshold - floating" if name == "otsu_threshold" else name]
    for k, dtype in zip(FLOATING.get(name, (0,)), dtypes, strict=True):
        inputs[k] = inputs[k].to(dtype)
    return tensors_of(case.call(*inputs))


def block_of(name: str) -> dict[str, str]:
    _, _, block = inspect.cleandoc(getattr(ops, name).__doc__).partition("\nConvention:\n")
    return dict(line.strip().split(": ", 1) for line in block.splitlines())


@EVERY_OP
def test_every_op_states_its_convention_and_source(name: str) -> None:
    assert list(block_of(name)) == ENTRIES
    assert all(word in getattr(ops, name).__doc__.lower() for word in ("source: ", "compiled"))
    twins = re.findall(r"`(kernels/\w+\.cpp)`", getattr(ops, name).__doc__)
    assert all((Path(__file__).parents[2] / path).is_file() for path in twins)
    assert name in OF_NAN, "a new op takes a line of it"


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("mixed", [False, True], ids=["alike", "mixed"])
@EVERY_OP
def test_dtype(name: str, mixed: bool, dtype: torch.dtype) -> None:
    """The result has the stated dtype, both if all inputs have one dtype and if only the last input (such as the
    points) has another dtype than float32. Half precision gives the result of float32, to four roundings.
    """
    floats = FLOATING.get(name, (0,))
    dtypes = [torch.float32 if mixed and k != floats[-1] else dtype for k in floats]
    inputs = inputs_of(name)
    result = results_of(name, inputs, dtypes)[0]
    assert result.dtype == DTYPES[block_of(name)["dtype"]](*dtypes)
    if dtype.itemsize == 2:
        expected = results_of(name, inputs, [torch.float32] * len(floats))[0].to(result.dtype)
        limit = 4 * torch.finfo(result.dtype).eps
        torch.testing.assert_close(result, expected, rtol=limit, atol=limit, equal_nan=True)


@EVERY_OP
def test_a_batch_of_no_frames_gives_no_results(name: str) -> None:
    inputs = [one[:0] if isinstance(one, Tensor) and len(one) == 2 else one for one in inputs_of(name)]
    for result in tensors_of(CASES["otsu_threshold - floating" if name == "otsu_threshold" else name].call(*inputs)):
        assert len(result) == 0


FRAMES, POINTS = torch.rand(2, 1, 24, 30), torch.rand(2, 8, 2)
TRIANGLES = torch.tensor([[0, 1, 2], [2, 3, 4]])
NONE: dict[str, tuple[Callable[[], Tensor], tuple[int, ...]]] = {
    "corners": (lambda: ops.detect_corners(FRAMES, 0).points, (2, 0, 2)),
    "queries": (lambda: ops.local_gradients(POINTS, POINTS, POINTS[:, :0], gauge_length=1.0).value, (2, 0, 2)),
    "points of a fit": (lambda: ops.local_gradients(POINTS[:, :0], POINTS[:, :0], gauge_length=1.0).value, (2, 0, 2)),
    "points tracked": (lambda: ops.track_points(FRAMES, FRAMES, POINTS[:, :0]).points, (2, 0, 2)),
    "triangles": (lambda: ops.triangle_gradients(POINTS, TRIANGLES[:0], POINTS), (2, 0, 2, 2)),
    "rows": (lambda: ops.median_filter(FRAMES[..., :0, :]), (2, 1, 0, 30)),
}


@pytest.mark.parametrize("name", NONE)
def test_nothing_asked_gives_nothing(name: str) -> None:
    call, shape = NONE[name]
    assert call().shape == shape


def gradcheck(op: Callable[..., Any], inputs: list[Tensor]) -> None:
    def floating(*values: Tensor) -> tuple[Tensor, ...]:
        return tuple(one.nan_to_num() for one in tensors_of(op(*values)) if one.dtype == torch.float64)

    assert torch.autograd.gradcheck(floating, [one.requires_grad_() for one in inputs], fast_mode=True)


@pytest.mark.parametrize(  # dense_flow and track_points: in their own tests
    "name", sorted({*ops.__all__} - {"dense_flow", "detect_corners", "otsu_threshold", "track_points"})
)
def test_derivatives(name: str) -> None:
    """Derivatives by all images and numbers are those of finite differences, with noise that leaves no pixels equal."""
    inputs, floats = inputs_of(name), FLOATING.get(name, (0,))

    def call(*values: Tensor) -> Any:
        return CASES[name].call(*(values[floats.index(k)] if k in floats else one for k, one in enumerate(inputs)))

    draw = torch.Generator().manual_seed(3)
    gradcheck(call, [inputs[k] + torch.rand(inputs[k].shape, generator=draw).double() / 10 for k in floats])


@pytest.mark.parametrize(
    ("op", "shapes"),
    [
        (lambda frame: corner_response(frame, 3), [(1, 1, 6, 7)]),
        (principal_strains, [(5, 3)]),
        (rigid_residual, [(2, 8, 2), (2, 8, 2), (2, 8)]),
        (lambda p, v, noise: ops.local_gradients(p, v, gauge_length=3.0, variance=noise), [(2, 8, 2)] * 2 + [(2, 8)]),
    ],
)
def test_derivatives_of_others(op: Callable[..., Any], shapes: list[tuple[int, ...]]) -> None:
    draw = torch.Generator().manual_seed(3)
    gradcheck(op, [0.1 + torch.rand(shape, generator=draw, dtype=torch.float64) for shape in shapes])


@pytest.mark.parametrize("op", [lambda *given: ops.local_gradients(*given, gauge_length=1.0).gradient,
                                lambda points, values: ops.triangle_gradients(points, TRIANGLES, values)])  # fmt: skip
def test_derivatives_are_finite_beside_missing_points(op: Callable[[Tensor, Tensor], Tensor]) -> None:
    points, values = (torch.rand((2, 8, 2), generator=torch.Generator().manual_seed(k)).double() for k in range(2))
    points[0, 0], points[1, 1], values[1, 2] = torch.nan, 100.0, torch.nan
    op(points.requires_grad_(), values.requires_grad_()).nansum().backward()
    for tensor in (points, values):
        assert tensor.grad is not None
        assert tensor.grad.isfinite().all()
        assert tensor.grad.abs().sum() > 0


GRADIENT = torch.tensor([[0.02, -0.01], [0.03, 0.01]], dtype=torch.float64)
SEEDS = scene(1)[2].double()
LINEAR = SEEDS @ GRADIENT.T
COLUMNS, ROWS = torch.arange(32.0, 49.0, 4.0).double(), torch.arange(28.0, 37.0, 4.0).double()


def elementwise(op: Callable[[Tensor], Tensor], given: Tensor) -> None:
    """Check that a NaN affects only its own element, and that each element gives the same result alone."""
    broken = given.clone()
    broken[0, 3, 0] = torch.nan
    found, wanted = op(broken), op(given)
    assert found[0, 3].isnan().any()
    found[0, 3] = wanted[0, 3]
    assert torch.equal(found, wanted)
    assert torch.equal(op(given[:, 3:4]), wanted[:, 3:4])


def gradients() -> Tensor:
    return (torch.rand(2, 6, 2, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64) - 0.5) / 10


AT = (0, 0, 30, 40)  # a pixel


def frame(with_nan: bool = True) -> Tensor:
    image = scene(1)[0].float()
    if with_nan:
        image[AT] = torch.nan
    return image


def around(reach: int) -> Tensor:
    """Return the pixels whose square of `reach` px to each side holds the pixel `AT`."""
    mask = torch.zeros(1, 1, HEIGHT, WIDTH, dtype=torch.bool)
    mask[..., AT[2] - reach : AT[2] + reach + 1, AT[3] - reach : AT[3] + reach + 1] = True
    return mask


def nan_median() -> None:
    assert torch.equal(ops.median_filter(frame(), 5).isnan(), around(2))


def nan_light() -> None:
    glass = torch.full_like(frame(), 200.0)
    broken = glass.masked_fill(around(0), torch.nan)
    for result in (ops.normalize_illumination(broken, glass), ops.normalize_illumination(glass, broken)):
        assert torch.equal(result.valid, ~around(0))
        assert result.frames[AT] == 1


def nan_otsu() -> None:
    all_but_one = ops.otsu_threshold(frame(False), ~around(0), (-1.0, 255.0))
    assert torch.equal(ops.otsu_threshold(frame(), None, (-1.0, 255.0)), all_but_one)
    assert ops.otsu_threshold(torch.full((1, 1, 4, 4), 7, dtype=torch.uint8)).isnan().all()


def nan_corners() -> None:
    found = ops.detect_corners(frame(), 5000, 1.0, window=7, noise=0.0)
    x, y = found.points[found.valid].long().T
    assert len(x) > 20
    assert not around(4)[0, 0, y, x].any()  # half a window and one pixel of the gradient
    assert found.points[~found.valid].isnan().all()


def nan_tracks() -> None:
    _, current, points, _ = scene(1)
    points = torch.cat((points, torch.tensor([[[AT[3] + 3.0, AT[2] - 4.0]]])), 1)
    points[0, 0] = torch.nan
    tracks = ops.track_points(frame(), current.float(), points, window=11, passes=1)
    clean = ops.track_points(frame(False), current.float(), points, window=11, passes=1)
    near = (points - torch.tensor([AT[3], AT[2]]).float()).abs().amax(-1) <= 5
    assert near.any()
    assert tracks.points[near].isnan().all()
    assert tracks.points[0, 0].isnan().all()
    assert (tracks.status[near] != 0).all()
    assert tracks.status[0, 0] != 0
    far = (points - torch.tensor([AT[3], AT[2]]).float()).abs().amax(-1) > 5 + 3 + 1
    assert far.any()
    torch.testing.assert_close(tracks.points[far], clean.points[far], rtol=0, atol=2e-3)  # the noise estimate differs


def nan_flow() -> None:
    found = ops.dense_flow(frame(), scene(1)[1].float(), noise=torch.ones(1)).displacement
    assert found[:, :, AT[2], AT[3]].isnan().all()
    assert found[..., AT[2] + 16 : -4, 4:-4].isfinite().all()


def nan_points(name: str) -> None:
    points, values = SEEDS.clone(), LINEAR.clone()
    points[0, 0] = values[0, 1, 0] = torch.nan

    def of(points: Tensor, values: Tensor) -> Tensor:
        if name == "scattered_to_grid":
            return ops.scattered_to_grid(points, values, COLUMNS, ROWS, 60.0)
        return ops.local_gradients(points, values, SEEDS, gauge_length=60.0).gradient

    wanted = of(points[:, 2:], values[:, 2:])
    assert wanted.isfinite().any()
    torch.testing.assert_close(of(points, values), wanted, rtol=1e-9, atol=1e-9, equal_nan=True)


def nan_triangles() -> None:
    values = LINEAR.clone()
    values[0, 1, 0] = torch.nan
    found = ops.triangle_gradients(SEEDS, torch.tensor([[0, 1, 2], [0, 3, 4]]), values, minimum_quality=0.0)
    assert found[0, 0].isnan().all()
    assert found[0, 1].isfinite().all()


OF_NAN: dict[str, Callable[[], None]] = {
    "curl": lambda: elementwise(ops.curl, gradients().flip(-2)),  # NaN in one of its two components
    "dense_flow": nan_flow,
    "detect_corners": nan_corners,
    "divergence": lambda: elementwise(ops.divergence, gradients()),
    "green_lagrange": lambda: elementwise(ops.green_lagrange, gradients()),
    "local_gradients": lambda: nan_points("local_gradients"),
    "median_filter": nan_median,
    "normalize_illumination": nan_light,
    "otsu_threshold": nan_otsu,
    "scattered_to_grid": lambda: nan_points("scattered_to_grid"),
    "strain_energy_density": lambda: elementwise(ops.strain_energy_density, ops.green_lagrange(gradients())),
    "track_points": nan_tracks,
    "triangle_gradients": nan_triangles,
}


@pytest.mark.usefixtures("each_form")
@pytest.mark.parametrize("name", ops.__all__)
def test_not_a_number(name: str) -> None:
    OF_NAN[name]()


BLANK, IMAGE, MASK = torch.zeros(2, 1, 9, 9), torch.ones(1, 1, 9, 9), torch.zeros(1, 1, 9, 9).bool()
NODES, TRIANGLE, GRID = torch.zeros(2, 5, 2), torch.tensor([[0, 1, 2]]), torch.linspace(-1, 1, 3)
NO_GRADIENT, STRAIN = torch.zeros(2, 2), torch.zeros(3)
DISC = FrameEllipse(torch.zeros(1, 2), torch.ones(1, 2), torch.zeros(1))
MEASURES = "green_lagrange, as_printed, infinitesimal"

#: Valid arguments of each op.
FITTED: dict[Callable[..., Any], dict[str, Any]] = {
    area_medians: {**{"reference": NODES[:1], "displacement": NODES[:1], "ellipse": DISC, "gauge_length": 1.0}},
    ops.detect_corners: {"frame": IMAGE},
    ops.dense_flow: {"first": BLANK[:1], "current": BLANK[:1]},
    ops.local_gradients: {"points": NODES, "values": NODES, "gauge_length": 1.0},
    ops.normalize_illumination: {"frames": BLANK, "reference": BLANK},
    ops.scattered_to_grid: {
        **{"points": NODES, "values": NODES, "grid_x": GRID, "grid_y": GRID[:2], "gauge_length": 1.0}
    },
    ops.strain_energy_density: {"strain": STRAIN},
    ops.track_points: {"previous": BLANK, "current": BLANK, "points": NODES},
    ops.triangle_gradients: {"points": NODES, "triangles": TRIANGLE, "values": NODES},
    real_contact_mask: {"frames": BLANK, "light": IMAGE, "black": IMAGE, "limit": torch.zeros(2)},
    rigid_residual: {"points": NODES, "displacement": NODES},
}

#: (op, arguments that are changed, pattern of the error message).
REFUSED: list[tuple[Callable[..., Any], dict[str, Any], str]] = [
    (ops.normalize_illumination, {"reference": IMAGE.repeat(3, 1, 1, 1)}, r"reference has shape \(3, 1, 9, 9\)"),
    (ops.normalize_illumination, {"dark": IMAGE[..., 1:]}, r"dark has shape \(1, 1, 9, 8\)"),
    (ops.normalize_illumination, {"minimum_illumination": 1.5}, r"minimum_illumination is 1\.5"),
    *[(ops.median_filter, {"frames": IMAGE.to(kind)}, str(kind)) for kind in (torch.bool, torch.complex64)],
    (ops.median_filter, {"frames": IMAGE[0, 0]}, r"\(9, 9\).*\(B, 1, H, W\)"),
    (ops.median_filter, {"frames": torch.zeros(1, 3, 9, 9)}, r"\(1, 3, 9, 9\)"),
    (ops.median_filter, {"frames": IMAGE, "size": 4}, "4 x 4.*odd"),
    (frame_quantile, {"frames": IMAGE, "fraction": 1.5}, r"1\.5"),
    (apparent_contact, {"mask": MASK.byte(), "radius": 3}, "uint8"),
    (apparent_contact, {"mask": MASK[0], "radius": 3}, "shape"),
    *[(apparent_contact, {"mask": MASK, "radius": radius}, f"radius of {radius} px") for radius in (0, 256)],
    (apparent_contact, {"mask": MASK, "radius": 3, "cell": 8}, "cells of 8 px"),
    (histogram, {"frames": IMAGE, "value_range": (1, 1)}, r"\(1, 1\): high must be above low"),
    *[(ops.otsu_threshold, {"frames": IMAGE.to(kind)}, "value_range") for kind in (torch.uint16, torch.float32)],
    (real_contact_mask, {"frames": BLANK[0]}, "frames have shape"),
    (real_contact_mask, {"black": IMAGE[..., 1:]}, "black has shape"),
    (real_contact_mask, {"limit": torch.zeros(3)}, "one number a frame"),
    (estimate_noise, {"images": IMAGE[..., :2]}, r"frames of \(9, 2\) px"),
    (unsharp_mask, {"frames": IMAGE, "sigma": 0}, "sigma is 0"),
    (subtract_background, {"frames": BLANK, "background": IMAGE.repeat(3, 1, 1, 1)}, r"\(3, 1, 9, 9\)"),
    (ops.detect_corners, {"count": -1}, "count -1"),
    (ops.detect_corners, {"quality": 1.5}, r"quality 1\.5"),
    (ops.detect_corners, {"min_distance": math.nan}, "min_distance nan"),
    (ops.detect_corners, {"window": 4}, "window is 4"),
    (ops.detect_corners, {"frame": IMAGE[..., :2, :]}, "noise="),
    (ops.dense_flow, {"first": BLANK[0]}, "first must be"),
    (ops.dense_flow, {"current": BLANK[:1, ..., 1:]}, "current must be"),
    (ops.dense_flow, {"initial": torch.zeros(1, 2, 3, 3)}, "initial must be"),
    (ops.dense_flow, {"mask": IMAGE}, "mask must be bool"),
    (ops.dense_flow, {"box": 4}, "box must be odd"),
    (ops.dense_flow, {"roughness": 0.0}, "roughness above 0"),
    (ops.dense_flow, {"warps": 0}, "warps must be at least 1"),
    (ops.dense_flow, {"model": "huber"}, "model must be one of .*'charbonnier'.*, not 'huber'"),
    (ops.dense_flow, {"first": IMAGE[..., :4], "current": IMAGE[..., :4]}, "at least 8 x 8"),
    (ops.track_points, {"window": 20}, "odd"),
    (ops.track_points, {"passes": 3}, "passes"),
    (ops.track_points, {"points": torch.zeros(2, 3)}, "points"),
    (ops.track_points, {"points": NODES.long()}, "floating"),
    (ops.track_points, {"current": BLANK[..., 1:]}, "same shape"),
    (ops.track_points, {"initial": NODES[:, 1:]}, "initial"),
    (ops.track_points, {"warp": NODES}, "warp"),
    (ops.track_points, {"noise": torch.zeros(3)}, "noise"),
    (area_medians, {"displacement": NODES[:1].int()}, "values must be floating"),
    (area_medians, {"displacement": torch.zeros(1, 5, 3)}, "displacement"),
    (area_medians, {"displacement": NODES[:1, 1:]}, "points"),
    (area_medians, {"reference": NODES}, "reference has 2 frames"),
    (area_medians, {"ellipse": DISC._replace(center=torch.zeros(2, 2))}, "center must be"),
    (area_medians, {"ellipse": DISC._replace(angle=torch.zeros(1, 1))}, "angle must be"),
    (area_medians, {"covariance": torch.zeros(1, 5)}, "covariance must be"),
    (area_medians, {"measure": "hencky"}, f"'hencky'.*{MEASURES}"),
    (ops.green_lagrange, {"gradient": NO_GRADIENT, "measure": "almansi"}, f"'almansi'.*{MEASURES}"),
    (field_std, {"gradient": NO_GRADIENT, "covariance": torch.zeros(2, 2, 2, 2), "measure": "hencky"}, MEASURES),
    *[(area_medians, {"gauge_length": gauge}, "gauge_length must be") for gauge in (0.0, math.nan)],
    (ops.scattered_to_grid, {"grid_y": GRID[None]}, r"grid_y .*\(1, 3\)"),
    (ops.scattered_to_grid, {"mask": torch.ones(1, 1, 2, 3)}, r"torch.float32 \(1, 1, 2, 3\)"),
    (ops.scattered_to_grid, {"mask": MASK}, r"\(B, 1, 2, 3\), found torch.bool \(1, 1, 9, 9\)"),
    *[(ops.local_gradients, {"gauge_length": gauge}, f"found {gauge}") for gauge in (0.0, -1.0, math.nan, math.inf)],
    (ops.local_gradients, {"minimum_points": 2}, "found 2"),
    (ops.local_gradients, {"values": NODES.long()}, "int64"),
    (ops.local_gradients, {"queries": torch.zeros(2, 5, 3)}, r"\(2, 5, 3\)"),
    (ops.local_gradients, {"queries": torch.zeros(3, 5, 2)}, "queries 3"),
    (ops.local_gradients, {"variance": NODES}, r"\(2, 5, 2\)"),
    (ops.local_gradients, {"variance": torch.zeros(3, 5)}, "variance 3"),
    (ops.triangle_gradients, {"points": NODES.long()}, "int64"),
    (ops.triangle_gradients, {"triangles": TRIANGLE.double()}, "float64"),
    (ops.triangle_gradients, {"triangles": TRIANGLE[:, :2]}, r"\(1, 2\)"),
    (ops.triangle_gradients, {"values": NODES[:, 1:]}, r"\(2, 4, 2\)"),
    (ops.triangle_gradients, {"values": torch.zeros(3, 5, 2)}, "points 2, values 3"),
    (ops.triangle_gradients, {"minimum_quality": 1.5}, r"1\.5"),
    (rigid_residual, {"displacement": torch.zeros(2, 5, 3)}, r"\(2, 5, 3\)"),
    (rigid_residual, {"weights": torch.ones(1, 4)}, r"\(1, 4\)"),
    (ops.divergence, {"gradient": torch.zeros(3, 2)}, r"\(3, 2\)"),
    (ops.strain_energy_density, {"strain": torch.zeros(4, 2)}, r"\(4, 2\)"),
    *[(ops.strain_energy_density, {"poisson_ratio": one}, f"found {one}") for one in (0.5, -1.0, math.nan)],
    *[(ops.strain_energy_density, {"young_modulus_mpa": one}, f"found {one}") for one in (0.0, math.inf, math.nan)],
]


@pytest.mark.parametrize(("op", "change", "words"), REFUSED)
def test_the_error_names_what_was_found(op: Callable[..., Any], change: dict[str, Any], words: str) -> None:
    with pytest.raises((TypeError, ValueError), match=words):
        op(**{**FITTED.get(op, {}), **change})
