"""The compiled quotient of light: bit for bit what the portable op gives."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.ops import normalize_illumination

ODD = torch.tensor([torch.nan, torch.inf, -torch.inf, 0.0, -3.0, 3e38, 1e-42])


def image(kind: torch.dtype, batch: int, height: int, width: int, seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    if not kind.is_floating_point:
        return torch.randint(0, 250, (batch, 1, height, width), generator=generator).to(kind)
    values = torch.rand(batch, 1, height, width, generator=generator) * 250
    odd = torch.rand(values.shape, generator=generator) < 0.05
    values[odd] = ODD[torch.randint(0, len(ODD), (int(odd.sum()),), generator=generator)]
    return values


@pytest.mark.usefixtures("instruction_set")
@pytest.mark.parametrize("kind", kernels.FRAME_KINDS, ids=str)
@pytest.mark.parametrize("dark", [None, 1, 3])
@pytest.mark.parametrize(
    ("batch", "lights", "height", "width"), [(1, 1, 1, 1), (3, 1, 17, 33), (3, 3, 40, 5), (0, 1, 4, 4)]
)
def test_as_the_portable_op(
    kind: torch.dtype,
    dark: int | None,
    batch: int,
    lights: int,
    height: int,
    width: int,
    portable: Callable[[Callable[[], object]], object],
) -> None:
    frames = image(kind, batch, height, width, 0)
    reference = image(torch.float32, min(lights, batch) if batch else 1, height, width, 1)
    black = None if dark is None else image(torch.float32, dark if batch == dark else 1, height, width, 2) / 50
    for given in (frames, frames.mT.contiguous().mT):
        compiled = normalize_illumination(given, reference, black)
        other = portable(lambda given=given: normalize_illumination(given, reference, black))
        assert isinstance(other, tuple)
        for one, another in zip(compiled, other, strict=True):
            assert torch.equal(one, another)


def test_what_does_not_fit_is_refused() -> None:
    frames, light = torch.zeros(2, 1, 4, 4), torch.ones(1, 1, 4, 4)
    if not kernels.serve(frames):
        pytest.skip("the compiled kernels were not built or are turned off")
    with pytest.raises(ValueError, match="least"):
        kernels.normalize(frames, light, light, torch.zeros(2))
    with pytest.raises(ValueError, match="light of"):
        kernels.normalize(frames, light[..., :3], light, torch.zeros(1))
