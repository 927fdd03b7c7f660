"""Dense flow on ridges whose motion is known at every pixel, and on what has none."""

import math
from collections.abc import Callable

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.ops import dense_flow
from fingerflow.ops.flow import flow_descent, flow_multigrid
from fingerflow.ops.flow.dense_flow import Flow, _sampled, find_flow, prepare_flow
from fingerflow.ops.flow.flow_penalty import Penalty

HEIGHT, WIDTH = 128, 160
Motion = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]


def texture(seed: int = 3, waves: int = 200) -> Motion:
    """Ridges of all directions with periods of 9 to 22 px: grey levels at real positions."""
    generator = torch.Generator().manual_seed(seed)
    period, angle, phase = torch.rand(3, waves, generator=generator, dtype=torch.float64)
    period, angle, phase = 9 + 13 * period, 2 * math.pi * angle, 2 * math.pi * phase
    along = 2 * math.pi / period * torch.stack((angle.cos(), angle.sin()))

    def grey(x: Tensor, y: Tensor) -> Tensor:
        total = torch.zeros_like(x)
        for right, down, begin in zip(*along.tolist(), phase.tolist(), strict=True):
            total += torch.cos(right * x + down * y + begin)
        return 110 + 35 * total / math.sqrt(waves / 2)

    return grey


GREY = texture()
PENALTIES = pytest.mark.parametrize("penalty", ["quadratic", "charbonnier"])


def grid(shape: tuple[int, int] = (HEIGHT, WIDTH)) -> tuple[Tensor, Tensor]:
    y, x = torch.meshgrid(*(torch.arange(side, dtype=torch.float64) for side in shape), indexing="ij")
    return x, y


def pair(motion: Motion, noise: float = 0.0, seed: int = 0, shape: tuple[int, int] = (HEIGHT, WIDTH)) -> tuple:
    """Both images (float64, not rounded) and the truth (1, 2, H, W)."""
    x, y = grid(shape)
    material_x, material_y = x, y
    for _ in range(40):
        u, v = motion(material_x, material_y)
        material_x, material_y = x - u, y - v
    generator = torch.Generator().manual_seed(seed)
    images = [
        grey[None, None] + noise * torch.randn(1, 1, *shape, generator=generator, dtype=torch.float64)
        for grey in (GREY(x, y), GREY(material_x, material_y))
    ]
    return *images, torch.stack(motion(x, y))[None]


def wave(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Up to 1.2 px, 2 % of strain."""
    return 0.7 * torch.sin(x / 40 + 0.3) + 0.5 * torch.cos(y / 50), 0.8 * torch.cos((x + y) / 60)


def widening(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    return 0.03 * (x - 80) - 0.01 * (y - 60), 0.01 * (x - 80) + 0.02 * (y - 60)


def photograph(image: Tensor) -> Tensor:
    return image.round().clamp(0, 255).to(torch.uint8)


def errors(found: Tensor, truth: Tensor, border: int = 0) -> Tensor:
    apart = (found - truth).norm(dim=1)
    return apart[:, border : apart.shape[1] - border, border : apart.shape[2] - border]


@PENALTIES
def test_no_motion_is_exactly_zero(penalty: Penalty) -> None:
    image = photograph(pair(wave, 2.0)[0])
    assert (dense_flow(image, image, penalty=penalty).displacement == 0).all()


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.4, -0.3), (1.5, 0.9), (-2.0, 1.7)])
def test_a_shift_without_noise_is_found(shift: tuple[float, float]) -> None:
    """The spline's low-pass is the same for both images; what is left is its interpolation, and a start from
    nothing at the border, where pixels leave the picture."""
    first, current, truth = pair(lambda x, y: (0 * x + shift[0], 0 * y + shift[1]))
    flow = dense_flow(first, current, noise=torch.tensor([0.1]))
    known = errors(flow.displacement, truth)
    assert known.nanmean() < 5e-3
    assert known[:, 8:-8, 8:-8].max() < 0.03


@pytest.mark.parametrize("motion", [wave, widening])
def test_skin_that_stretches(motion: Motion) -> None:
    """8 bit, noise of 2 grey levels: the goal is 0.015 px on average in the interior; at the border windows are cut."""
    first, current, truth = pair(motion, noise=2.0)
    flow = dense_flow(photograph(first), photograph(current))
    inner = errors(flow.displacement, truth, 24)
    assert inner.nanmean() < 0.015
    assert errors(flow.displacement, truth).nanmean() < 0.02
    farneback = cv2.calcOpticalFlowFarneback(
        *(photograph(one)[0, 0].numpy() for one in (first, current)), None, 0.5, 3, 21, 5, 7, 1.5, 0
    )
    peer = errors(torch.from_numpy(np.moveaxis(farneback, 2, 0))[None], truth, 24)
    assert inner.nanmean() < 0.6 * peer.mean()


@PENALTIES
def test_the_deviation_covers_the_error(penalty: Penalty) -> None:
    z = []
    for seed in range(4):
        first, current, truth = pair(widening, noise=3.0, seed=seed)
        flow = dense_flow(first, current, noise=torch.tensor([3.0]), penalty=penalty)
        variance = torch.stack((flow.covariance[:, 0, 0], flow.covariance[:, 1, 1]), dim=1)
        z.append(((flow.displacement - truth) ** 2 / variance)[..., 12:-12, 12:-12].nanmean())
    assert 0.8 < float(torch.stack(z).mean().sqrt()) < 1.25
    assert 0.3 * 3 < float(flow.residual.nanmean()) < 0.5 * 3  # as the docstring has it


def test_light_that_changes_moves_nothing() -> None:
    first, current, truth = pair(wave, noise=1.0)
    steady = dense_flow(first, current)
    flow = dense_flow(first, 0.8 * current + 11)
    assert (flow.displacement - steady.displacement).nan_to_num().abs().max() < 1e-4
    assert errors(flow.displacement, truth, 24).nanmean() < 0.015
    assert flow.covariance[:, 0, 0].nanmean() > 1.2 * steady.covariance[:, 0, 0].nanmean()  # noise counts for more


def test_nothing_outside_the_mask_counts() -> None:
    """Beyond what the windows' spline sees of it."""
    first, current, truth = pair(widening, noise=1.0)
    x, y = grid()
    mask = (((x - 80) / 60) ** 2 + ((y - 64) / 45) ** 2 < 1)[None, None]
    around = torch.nn.functional.max_pool2d(mask.double(), 13, 1, 6) > 0
    other = [torch.where(around, one, 255 - one.flip(3)) for one in (first, current)]
    noise = torch.tensor([1.0])
    one, two = (dense_flow(*images, mask=mask, noise=noise) for images in ((first, current), other))
    assert one.displacement.isfinite().all(1).eq(mask[:, 0]).all()
    assert (one.displacement - two.displacement).nan_to_num().abs().max() < 5e-3
    # Skin widens up to the border of the mask: it is not pulled flat there.
    assert errors(one.displacement, truth).nanmean() < 0.015


def test_large_motion_from_where_it_is_expected() -> None:
    """13 px, which halving the images does not find on ridges; to a quarter of a period given, it is found."""
    first, current, truth = pair(lambda x, y: (0 * x + 13.0, 0 * y - 9.0), noise=2.0)
    flow = dense_flow(photograph(first), photograph(current), initial=truth.float() + 1.0, warps=4)
    known = errors(flow.displacement, truth)
    inside = known.isfinite()
    assert 0.75 < inside.double().mean() < 0.9  # what has left the picture has no displacement
    assert known[inside].mean() < 0.04  # where half of a window has left the picture, 0.2
    assert errors(flow.displacement, truth, 24).nanmean() < 0.015


def test_one_warp_from_the_frame_before() -> None:
    first, current, truth = pair(wave, noise=2.0)
    template = prepare_flow(first)
    cold = find_flow(template, current)
    warm = find_flow(template, current, cold.displacement, warps=1)
    assert errors(warm.displacement, truth, 24).nanmean() < 1.02 * errors(cold.displacement, truth, 24).nanmean()
    assert (warm.displacement - cold.displacement).nan_to_num().abs().mean() < 2e-3  # near the fixed point


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16, torch.int32, torch.float32, torch.float64])
def test_kinds_of_pixels(dtype: torch.dtype) -> None:
    first, current, truth = pair(wave)
    first, current = (one.round().clamp(0, 255).to(dtype) for one in (first, current))
    flow = dense_flow(first, current, noise=torch.tensor([0.3]))
    assert flow.displacement.dtype == (torch.float64 if dtype == torch.float64 else torch.float32)
    assert errors(flow.displacement, truth, 24).nanmean() < 0.01


def test_a_batch_is_its_images() -> None:
    pairs = [pair(motion, 1.0, seed)[:2] for seed, motion in enumerate((wave, widening))]
    firsts, currents = (torch.cat(some) for some in zip(*pairs, strict=True))
    together = dense_flow(firsts, currents)
    for k, (first, current) in enumerate(pairs):
        for whole, one in zip(together, dense_flow(first, current), strict=True):
            torch.testing.assert_close(whole[k : k + 1], one, equal_nan=True)


@pytest.mark.parametrize("level", [0, 128, 255])
def test_blank_images_move_nowhere_and_say_so(level: int) -> None:
    blank = torch.full((1, 1, 40, 48), level, dtype=torch.uint8)
    flow = dense_flow(blank, blank)
    assert (flow.displacement == 0).all()
    assert flow.covariance.isnan().all()


def test_stripes_show_motion_across_them_only() -> None:
    x, _ = grid((96, 96))
    first, current = ((110 + 60 * torch.cos(2 * math.pi / 12 * (x - moved)))[None, None] for moved in (0.0, 0.8))
    flow = dense_flow(first, current, noise=torch.tensor([1.0]))
    inner = (..., slice(16, -16), slice(16, -16))
    assert (flow.displacement[:, 0][inner] - 0.8).abs().max() < 0.01
    assert flow.displacement[:, 1][inner].abs().max() < 1e-3
    assert flow.covariance[:, 1, 1][inner].min() > 3 * flow.covariance[:, 0, 0][inner].max()


def test_pixels_that_are_not_finite_are_left_out() -> None:
    first, current, truth = pair(widening, noise=1.0)
    first[0, 0, 30:34, 40:44] = math.nan
    current[0, 0, 90, 100] = math.inf
    flow = dense_flow(first, current, noise=torch.tensor([1.0]))
    assert flow.displacement[0, 0, 31, 41].isnan()
    assert flow.displacement.isfinite().all(1).double().mean() > 0.9
    assert errors(flow.displacement, truth, 8).nanmean() < 0.015


def test_nothing_in_the_mask() -> None:
    image = photograph(pair(wave)[0])
    flow = dense_flow(image, image, mask=torch.zeros_like(image, dtype=torch.bool))
    assert all(one.isnan().all() for one in flow)


@PENALTIES
def test_differentiable_in_both_images(penalty: Penalty) -> None:
    """Against a central difference, in float64: through every warp and cycle."""
    first, current, _ = (one[..., :24, :32] for one in pair(wave, shape=(32, 40)))
    weight = torch.randn(1, 2, 24, 32, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    noise = torch.tensor([1.0], dtype=torch.float64)

    def total(first: Tensor, current: Tensor) -> Tensor:
        flow = dense_flow(first, current, torch.zeros_like(weight), warps=2, noise=noise, penalty=penalty)
        return (flow.displacement.nan_to_num() * weight).sum()

    images = [one.clone().requires_grad_() for one in (first, current)]
    total(*images).backward()
    for k, image in enumerate(images):
        direction = torch.randn(image.shape, generator=torch.Generator().manual_seed(2 + k), dtype=torch.float64)
        either = []
        for sign in (1, -1):
            moved = [one.detach() + sign * 1e-5 * direction * (place == k) for place, one in enumerate(images)]
            either.append(total(*moved))
        expected = (either[0] - either[1]) / 2e-5
        torch.testing.assert_close((image.grad * direction).sum(), expected, rtol=2e-4, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"first": torch.zeros(1, 40, 40)}, "first must be"),
        ({"current": torch.zeros(1, 1, 40, 41)}, "current must be"),
        ({"initial": torch.zeros(1, 2, 3, 3)}, "initial must be"),
        ({"mask": torch.zeros(1, 1, 40, 40)}, "mask must be bool"),
        ({"box": 4}, "box must be odd"),
        ({"roughness": 0.0}, "roughness above 0"),
        ({"warps": 0}, "warps must be at least 1"),
        ({"penalty": "huber"}, "penalty must be one of .*'charbonnier'.*, not 'huber'"),
        ({"first": torch.zeros(1, 1, 4, 4), "current": torch.zeros(1, 1, 4, 4)}, "at least 8 x 8"),
    ],
)
def test_wrong_input_is_named(change: dict, said: str) -> None:
    given = {"first": torch.zeros(1, 1, 40, 40), "current": torch.zeros(1, 1, 40, 40)} | change
    with pytest.raises(ValueError, match=said):
        dense_flow(**given)


@pytest.mark.skipif(not kernels.serve(), reason="no compiled kernels here")
@pytest.mark.parametrize("most", [0, 1, 2])
@PENALTIES
def test_compiled_and_portable_flow_are_one(penalty: Penalty, most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """1e-4 px, a hundredth of what noise leaves: sums are rounded otherwise, and every warp begins from the last."""
    first, current, _ = pair(wave, noise=2.0, shape=(90, 131))
    first, current = photograph(first), photograph(current)
    kernels.limit_instruction_set(most)
    try:
        compiled = dense_flow(first, current, penalty=penalty)
    finally:
        kernels.limit_instruction_set(-1)
    monkeypatch.setattr(kernels, "serve", lambda *_: False)
    portable = dense_flow(first, current, penalty=penalty)
    torch.testing.assert_close(compiled.displacement, portable.displacement, rtol=0, atol=1e-4, equal_nan=True)
    torch.testing.assert_close(compiled.covariance, portable.covariance, rtol=1e-3, atol=1e-8, equal_nan=True)


@pytest.mark.skipif(not kernels.serve(), reason="no compiled kernels here")
@pytest.mark.parametrize("most", [0, 1, 2])
@PENALTIES
def test_compiled_and_portable_flow_are_one_where_little_is_known(
    penalty: Penalty, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A batch, a mask with an island and single pixels, pixels that are not finite, light that changes, skin that
    leaves the picture: one warp from what is given, to 1e-4 px; covariance and residual to a thousandth."""
    shape = (67, 91)
    first, current, truth = (
        torch.cat(some) for some in zip(*(pair(wave, 2.0, seed, shape) for seed in (0, 1)), strict=True)
    )
    first, current = first.float(), 0.9 * current.float() + 5
    first[0, 0, 30, 40] = math.nan
    current[1, 0, 20:22, 50] = math.inf
    x, y = grid(shape)
    mask = (((x - 45) / 38) ** 2 + ((y - 30) / 24) ** 2 < 1) | ((x - 84).abs() + (y - 60).abs() < 4)
    mask[::13, ::17] = True
    initial = (0.8 * truth).float()
    initial[:, 1, :, :12] -= 6.0  # leaves at the top
    initial[0, 0, 5:9, 5:9] = math.nan

    def found() -> Flow:
        template = prepare_flow(first, mask.expand(2, 1, -1, -1), noise=torch.tensor([2.0, 2.0]))
        return find_flow(template, current, initial, warps=1, penalty=penalty)

    kernels.limit_instruction_set(most)
    try:
        compiled = found()
    finally:
        kernels.limit_instruction_set(-1)
    monkeypatch.setattr(kernels, "serve", lambda *_: False)
    portable = found()
    assert compiled.displacement.isfinite().any()
    assert compiled.displacement.isnan().any()
    torch.testing.assert_close(compiled.displacement, portable.displacement, rtol=0, atol=1e-4, equal_nan=True)
    for one, other in zip(compiled[1:], portable[1:], strict=True):
        torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-6, equal_nan=True)


@pytest.mark.skipif(not kernels.serve(), reason="no compiled kernels here")
@pytest.mark.parametrize("most", [0, 1, 2])
def test_compiled_warp_is_the_portable_one(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Displacements that jump between pixels, that are alike in runs, and that lead far outside."""
    generator = torch.Generator().manual_seed(2)
    coefficients = torch.randn(3, 1, 37, 61, generator=generator)
    flow = 4 * torch.randn(3, 2, 37, 61, generator=generator)
    flow[1] = torch.tensor([0.3, -1.0]).view(2, 1, 1)
    flow[2] *= 1e4
    kernels.limit_instruction_set(most)
    try:
        compiled = kernels.flow_warp(coefficients, flow)
    finally:
        kernels.limit_instruction_set(-1)
    monkeypatch.setattr(kernels, "serve", lambda *_: False)
    torch.testing.assert_close(compiled, _sampled(coefficients, flow), rtol=0, atol=3e-6)


def with_few_sweeps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two of the coarsest level, compiled and portable, for what is exported: the other 18 are the same operators."""
    for module in (flow_descent, flow_multigrid):
        monkeypatch.setattr(module, "COARSEST_SWEEPS", 2)


@PENALTIES
def test_the_portable_form_has_no_branch_on_data(penalty: Penalty, monkeypatch: pytest.MonkeyPatch) -> None:
    """What `torch.export` takes. With all sweeps these are 3,700 operators, for which the exporter to ONNX needs a
    minute; by ONNX Runtime they give the same to 1e-6 px."""
    with_few_sweeps(monkeypatch)
    first, current, truth = pair(wave, noise=2.0, shape=(9, 12))
    template = prepare_flow(photograph(first))

    class Found(torch.nn.Module):
        def forward(self, current: Tensor, initial: Tensor) -> tuple[Tensor, ...]:
            return tuple(find_flow(template, current, initial, warps=1, penalty=penalty))

    given = photograph(current), 0.8 * truth.float()
    exported = torch.export.export(Found(), given).module()(*given)
    for one, other in zip(exported, Found()(*given), strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=1e-4, equal_nan=True)
