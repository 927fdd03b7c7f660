"""Light lost in one pass: the three portable ops bit for bit, and float64."""

from collections.abc import Callable

import pytest
import torch
from kernel_images import SHAPES, images

from fingerflow import kernels
from fingerflow.ops.illumination import LightLost, light_lost

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

Portable = Callable[[Callable[[], object]], LightLost]
DTYPES = [torch.uint8, torch.uint16, torch.int32, torch.float32]


def assert_same(ours: LightLost, theirs: LightLost) -> None:
    for name, one, other in zip(LightLost._fields, ours, theirs, strict=True):
        assert one.dtype == other.dtype, name
        assert torch.equal(one, other), name


@pytest.mark.parametrize("dark_count", [None, 1, "all"])
@pytest.mark.parametrize("reference_count", [1, "all"])
@pytest.mark.parametrize("shape", SHAPES)
def test_same_as_the_portable_ops(
    portable: Portable,
    instruction_set: int,
    shape: tuple[int, int, int],
    reference_count: int | str,
    dark_count: int | str | None,
) -> None:
    frames = images(shape, torch.uint8, "random")
    reference = images((shape[0] if reference_count == "all" else 1, *shape[1:]), torch.uint8, "random", seed=1)
    dark = None
    if dark_count is not None:
        dark = images((shape[0] if dark_count == "all" else 1, *shape[1:]), torch.uint8, "random", seed=2) // 8
    assert_same(light_lost(frames, reference, dark), portable(lambda: light_lost(frames, reference, dark)))


@pytest.mark.parametrize("reference_dtype", DTYPES)
@pytest.mark.parametrize("dtype", DTYPES)
def test_every_pair_of_dtypes(portable: Portable, dtype: torch.dtype, reference_dtype: torch.dtype) -> None:
    highest = 250 if torch.uint8 in (dtype, reference_dtype) else 4095
    frames = images((2, 40, 50), dtype, "random", highest=highest)
    reference = images((1, 40, 50), reference_dtype, "random", seed=3, highest=highest)
    for minimum in (0.0, 0.05, 0.5):
        ours = light_lost(frames, reference, minimum_illumination=minimum)
        assert_same(ours, portable(lambda m=minimum: light_lost(frames, reference, minimum_illumination=m)))


def test_what_is_not_finite_is_not_valid(portable: Portable, instruction_set: int) -> None:
    strange = torch.tensor([torch.nan, torch.inf, -torch.inf, 0.0, -0.0, -5.0, 1e-42, 3e38, -3e38, 100.0])
    frames = strange.repeat(10, 1)[None, None]
    reference = strange[:, None].repeat(1, 10)[None, None]
    for dark in (None, torch.full_like(reference, 7.0), reference.flip(-1)):
        for minimum in (0.0, 0.05):
            ours = light_lost(frames, reference, dark, minimum_illumination=minimum)
            theirs = portable(lambda d=dark, m=minimum: light_lost(frames, reference, d, minimum_illumination=m))
            assert_same(ours, theirs)
            assert ours.signal.isfinite().all()
    for empty in (torch.nan, 0.0):
        assert not light_lost(frames, torch.full_like(reference, empty)).valid.any()


def test_equals_float64(instruction_set: int) -> None:
    frames = images((2, 64, 80), torch.uint16, "random", highest=4095)
    reference = images((1, 64, 80), torch.uint16, "random", seed=4, highest=4000).to(torch.int32) + 95
    truth = 1 - frames.double() / reference.double()
    lost = light_lost(frames, reference.to(torch.uint16), minimum_illumination=0.0)
    assert lost.valid.all()
    # One rounding of the quotient, one of the difference: half a unit in the last place each.
    assert (lost.signal - truth).abs().le(torch.finfo(torch.float32).eps * (1 + truth.abs())).all()
    level = (truth + 0.25) * 204
    assert (lost.levels - level.clamp(0, 255)).abs().max() <= 0.5001


def test_views_are_read_where_they_are(portable: Portable) -> None:
    both = images((3, 60, 160), torch.uint8, "random")
    frames, reference = both[..., 80:], both[:1, :, :, :80].clone().mT.contiguous().mT
    assert_same(light_lost(frames, reference), portable(lambda: light_lost(frames, reference)))


def test_refuses_what_does_not_fit() -> None:
    frames = torch.zeros(2, 1, 8, 8)
    with pytest.raises(ValueError, match="reference has shape"):
        light_lost(frames, frames[..., :7])
    with pytest.raises(ValueError, match="dark has shape"):
        light_lost(frames, frames, torch.zeros(3, 1, 8, 8))
    with pytest.raises(ValueError, match=r"minimum_illumination is 1\.5"):
        light_lost(frames, frames, minimum_illumination=1.5)
    with pytest.raises(TypeError, match="float64"):
        kernels.light_lost(frames.double(), frames, None, 0.05, -0.25, 204.0)
    with pytest.raises(ValueError, match="beside frames"):
        kernels.light_lost(frames, frames[:, :, :5], None, 0.05, -0.25, 204.0)


def test_gradients_go_through_the_portable_ops() -> None:
    frames = torch.full((1, 1, 4, 4), 50.0, requires_grad=True)
    light_lost(frames, torch.full((1, 1, 4, 4), 100.0)).signal.sum().backward()
    assert frames.grad is not None
    assert torch.allclose(frames.grad, torch.full_like(frames, -0.01))
