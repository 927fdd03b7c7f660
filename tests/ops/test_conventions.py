"""Tests of the Convention block of every public op: axes, sign, pixel centre, dtype and NaN are as stated.

A new op needs an entry in `SIGNS` and `OF_NAN`; the test of the op itself shows its border.
"""

import inspect
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from fingerflow import ops
from tests.embedded import CASES, HEIGHT, WIDTH, expected, scene, tensors_of

ENTRIES = ["axes", "sign", "pixel centre", "dtype", "NaN", "border"]

#: Which inputs of an op are images or numbers whose dtype counts.
FLOATING = {
    "dense_flow": (0, 1),
    "helmholtz_hodge": (0,),
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


@pytest.fixture(autouse=True)
def afresh() -> None:
    expected.cache_clear()


def results_of(name: str, inputs: tuple[Any, ...]) -> list[Tensor]:
    case = CASES["otsu_threshold - floating" if name == "otsu_threshold" else name]
    return tensors_of(case.call(*inputs))


def inputs_of(name: str) -> tuple[Any, ...]:
    return CASES["otsu_threshold - floating" if name == "otsu_threshold" else name].inputs


def block_of(name: str) -> dict[str, str]:
    _, _, block = inspect.cleandoc(getattr(ops, name).__doc__).partition("\nConvention:\n")
    return dict(line.strip().split(": ", 1) for line in block.splitlines())


@pytest.mark.parametrize("name", ops.__all__)
def test_every_op_states_its_convention(name: str) -> None:
    assert list(block_of(name)) == ENTRIES
    for table in (SIGNS, OF_NAN):
        assert name in table, "a new op takes a line of each"


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("mixed", [False, True], ids=["alike", "mixed"])
@pytest.mark.parametrize("name", ops.__all__)
def test_dtype(name: str, mixed: bool, dtype: torch.dtype) -> None:
    """The result has the stated dtype, both if all inputs have one dtype and if only the last input (such as the
    points) has another dtype than float32.
    """
    inputs = list(inputs_of(name))
    floats = FLOATING.get(name, (0,))
    for k in floats:
        inputs[k] = inputs[k].to(torch.float32 if mixed and k != floats[-1] else dtype)
    wanted = DTYPES[block_of(name)["dtype"]](*(inputs[k].dtype for k in floats))
    assert results_of(name, tuple(inputs))[0].dtype == wanted


GRADIENT = torch.tensor([[0.02, -0.01], [0.03, 0.01]], dtype=torch.float64)
POINTS = scene(1)[2].double()
LINEAR = POINTS @ GRADIENT.T
COLUMNS, ROWS = torch.arange(32.0, 49.0, 4.0).double(), torch.arange(28.0, 37.0, 4.0).double()


def image_of(columns: slice, rows: slice, value: float = 200.0) -> Tensor:
    image = torch.zeros(1, 1, HEIGHT, WIDTH)
    image[..., rows, columns] = value
    return image


STRIPE = image_of(slice(30, 44), slice(None))


def stretched() -> tuple[Tensor, Tensor, Tensor]:
    """Return waves, the same waves stretched by 3 % in x and compressed by 2 % in y about pixel (16, 16), and the
    truth.

    The true displacement is (1, 2, H, W) px at whole pixels: centres half a pixel off would shift it by 0.015 px.
    """
    y, x = torch.meshgrid(torch.arange(float(HEIGHT)), torch.arange(float(WIDTH)), indexing="ij")
    waves = torch.rand(3, 40, 1, 1, generator=torch.Generator().manual_seed(1)) * 2 - 1

    def at(x: Tensor, y: Tensor) -> Tensor:
        return (110 + 14 * torch.sin(waves[0] * x + waves[1] * y + 9 * waves[2]).sum(0))[None, None]

    truth = torch.stack((0.03 * (x - 16), -0.02 * (y - 16)))[None]
    return at(x, y), at(16 + (x - 16) / 1.03, 16 + (y - 16) / 0.98), truth


def off_by_tracks() -> Tensor:
    """Return the median error (x, y) of tracked points, px."""
    first, second, truth = stretched()
    points = scene(1)[2].round()
    x, y = points[0].long().T
    moved = ops.track_points(first, second, points, window=11).points - points
    return (moved - truth[:, :, y, x].mT).nanmedian(1).values[0]


def off_by_flow() -> Tensor:
    first, second, truth = stretched()
    return (ops.dense_flow(first, second).displacement - truth)[..., 8:-8, 8:-8].flatten(2).nanmedian(2).values[0]


def swirl() -> Tensor:
    """Return the share of the solenoidal part in a rotation from x towards y within a disc."""
    y, x = torch.meshgrid(torch.arange(-20.0, 21.0), torch.arange(-20.0, 21.0), indexing="ij")
    field, disc = torch.stack((-y, x))[None], (x.square() + y.square() < 324)[None, None]
    parts = ops.helmholtz_hodge(field, disc)
    return (parts.solenoidal * field)[disc.expand_as(field)].sum() / field[disc.expand_as(field)].square().sum()


#: (computation, true value, tolerance): sign and order of axes by examples known in closed form.
SIGNS: dict[str, tuple[Callable[[], Any], Any, float]] = {
    "curl": (lambda: ops.curl(GRADIENT), 0.04, 1e-12),
    "dense_flow": (off_by_flow, [0.0, 0.0], 0.007),
    "detect_corners": (
        lambda: (
            ops.detect_corners(image_of(slice(30, 44), slice(12, 20)), 4, 6.0, noise=1.0, window=3)
            .points[0]
            .sort(0)
            .values
        ),
        [[30.0, 12.0], [30.0, 12.0], [43.0, 19.0], [43.0, 19.0]],
        1.0,  # a corner of a shape lies between pixels
    ),
    "divergence": (lambda: ops.divergence(GRADIENT), 0.03, 1e-12),
    "green_lagrange": (lambda: ops.green_lagrange(GRADIENT), [0.02065, 0.0101, 0.01005], 1e-12),
    "helmholtz_hodge": (swirl, 1.0, 0.05),  # the staircase border of the disc
    "local_gradients": (
        lambda: ops.local_gradients(POINTS, LINEAR, gauge_length=60.0).gradient.nanmean((0, 1)),
        GRADIENT.tolist(),
        1e-12,
    ),
    "median_filter": (
        lambda: ops.median_filter(STRIPE, 5),
        STRIPE.tolist(),
        0.0,
    ),
    "normalize_illumination": (
        lambda: ops.normalize_illumination(torch.full((1, 1, 4, 4), 50), torch.full((1, 1, 4, 4), 200)).frames.amax(),
        0.25,
        0.0,
    ),
    "otsu_threshold": (
        lambda: ops.otsu_threshold(STRIPE, value_range=(-1.0, 255.0)) < STRIPE,
        (STRIPE > 0).tolist(),
        0.0,
    ),
    "scattered_to_grid": (
        lambda: ops.scattered_to_grid(POINTS, LINEAR, COLUMNS, ROWS, 60.0)[0, :, 1, 2],
        (GRADIENT @ torch.stack((COLUMNS[2], ROWS[1]))).tolist(),
        1e-12,
    ),
    "strain_energy_density": (  # E (1 - nu) / (2 (1 + nu) (1 - 2 nu)) exx^2
        lambda: ops.strain_energy_density(torch.tensor([-0.01, 0.0, 0.0], dtype=torch.float64)),
        0.6 / (2 * 1.4 * 0.2) * 1e-4,
        1e-15,
    ),
    "track_points": (off_by_tracks, [0.0, 0.0], 0.007),
    "triangle_gradients": (
        lambda: ops.triangle_gradients(POINTS, torch.tensor([[0, 1, 2], [1, 0, 2]]), LINEAR)[0],
        [GRADIENT.tolist()] * 2,
        1e-9,
    ),
}


@pytest.mark.usefixtures("each_form")
@pytest.mark.parametrize("name", ops.__all__)
def test_sign(name: str) -> None:
    compute, wanted, tolerance = SIGNS[name]
    found = torch.as_tensor(compute()).double()
    torch.testing.assert_close(found, torch.tensor(wanted, dtype=torch.float64), rtol=0, atol=tolerance)


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
    points, values = POINTS.clone(), LINEAR.clone()
    points[0, 0] = values[0, 1, 0] = torch.nan

    def of(points: Tensor, values: Tensor) -> Tensor:
        if name == "scattered_to_grid":
            return ops.scattered_to_grid(points, values, COLUMNS, ROWS, 60.0)
        return ops.local_gradients(points, values, POINTS, gauge_length=60.0).gradient

    wanted = of(points[:, 2:], values[:, 2:])
    assert wanted.isfinite().any()
    torch.testing.assert_close(of(points, values), wanted, rtol=1e-9, atol=1e-9, equal_nan=True)


def nan_triangles() -> None:
    values = LINEAR.clone()
    values[0, 1, 0] = torch.nan
    found = ops.triangle_gradients(POINTS, torch.tensor([[0, 1, 2], [0, 3, 4]]), values, minimum_quality=0.0)
    assert found[0, 0].isnan().all()
    assert found[0, 1].isfinite().all()


def nan_parts() -> None:
    parts = ops.helmholtz_hodge(frame().expand(-1, 2, -1, -1))
    for part in parts:
        assert torch.equal(part.isnan(), around(0).expand_as(part))


OF_NAN: dict[str, Callable[[], None]] = {
    "curl": lambda: elementwise(ops.curl, gradients().flip(-2)),  # NaN in one of its two components
    "dense_flow": nan_flow,
    "detect_corners": nan_corners,
    "divergence": lambda: elementwise(ops.divergence, gradients()),
    "green_lagrange": lambda: elementwise(ops.green_lagrange, gradients()),
    "helmholtz_hodge": nan_parts,
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
