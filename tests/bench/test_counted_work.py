"""Tests of counted bytes and operations against counts by hand, and of the time predicted from them."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.devices import DEVICES, Device, fused_tracking, predicted_seconds
from bench.launches import Work, count_launches


class Formula(nn.Module):
    def __init__(self, formula: Callable[..., Tensor]) -> None:
        super().__init__()
        self.formula = formula

    def forward(self, *given: Tensor) -> Tensor:
        return self.formula(*given)


WHOLE = torch.zeros(5, 40)
COUNTED: dict[str, tuple[Callable[..., Tensor], tuple[Tensor, ...], Work]] = {
    "element by element": (torch.add, (WHOLE, WHOLE), Work(3 * 4 * 200, 200)),
    "bytes": (torch.add, (WHOLE.byte(), WHOLE.byte()), Work(3 * 200, 200)),
    "a row for all": (lambda whole: whole + whole[:1].expand(5, 40), (WHOLE,), Work(4 * (200 + 40 + 200), 200)),
    "a sum": (torch.sum, (WHOLE,), Work(4 * 201, 200)),
    "a product": (torch.matmul, (WHOLE, WHOLE.T.contiguous()), Work(4 * (200 + 200 + 25), 2 * 25 * 40)),
    "a product with a vector": (torch.matmul, (WHOLE, torch.zeros(40)), Work(4 * (200 + 40 + 5), 2 * 5 * 40)),
    "chosen rows": (
        lambda whole, rows: whole.index_select(0, rows),
        (WHOLE, torch.tensor([3, 3])),
        Work(4 * (80 + 80) + 8 * 2, 200),
    ),
    "a convolution": (
        functional.conv2d,
        (torch.zeros(1, 3, 8, 8), torch.zeros(2, 3, 3, 3)),
        Work(4 * (192 + 54 + 72), 2 * 72 * 27),
    ),
}


@pytest.mark.parametrize("name", COUNTED)
def test_work_of_a_call(name: str) -> None:
    formula, inputs, work = COUNTED[name]
    assert count_launches(Formula(formula), inputs).work == (work,)


def test_most_bytes_alive_at_a_time() -> None:
    """The peak counts the bytes that a step allocates; views and inputs do not count, and freed bytes count no more."""
    formula = Formula(lambda whole: (((whole * 2)[:, :20] + 1) * 3).sum())
    assert count_launches(formula, (WHOLE,)).peak == 4 * (200 + 100)
    assert count_launches(Formula(lambda whole: (whole + 1).exp().exp().exp()), (WHOLE,)).peak == 2 * 4 * 200


def test_predicted_time_is_that_of_the_slowest_of_three() -> None:
    device = Device(bandwidth=1e9, peak=1e12, eager=5e-6, captured=1e-6)
    of_start, of_bytes, of_operations = Work(10, 10), Work(20_000, 0), Work(0, 30_000_000)
    assert predicted_seconds([of_start, of_bytes, of_operations], device, captured=False) == pytest.approx(55e-6)
    assert predicted_seconds([of_start, of_bytes, of_operations], device, captured=True) == pytest.approx(51e-6)


def test_work_of_the_fused_kernel() -> None:
    """The fused kernel reads a template once for all frames and a patch in each frame; a window of 25 px fills a tile
    of 32 x 32.
    """
    (alone,), (chunk,) = (fused_tracking(700, 25, 1, frames) for frames in (1, 8))
    assert alone.bytes - chunk.bytes == pytest.approx(700 * 4 * (3 * 625 + 32) * 7 / 8, rel=1e-3)
    assert chunk.bytes > 700 * 31**2
    assert alone.flops == chunk.flops > 700 * 4 * 32**3


def test_a_captured_step_takes_no_longer_anywhere() -> None:
    for device in DEVICES.values():
        assert device.captured < device.eager
