"""Tests that default dtype and device of torch, set by the surrounding process, change no result."""

import subprocess
import sys
from collections.abc import Iterator

import pytest
import torch

from fingerflow.ops.contact import apparent_contact, otsu
from tests.embedded import CASES, expected, tensors_of, without_a_case


@pytest.fixture
def restored() -> Iterator[None]:
    expected.cache_clear()  # cached by the other form
    yield
    torch.set_default_dtype(torch.float32)
    torch.set_default_device(None)


def test_every_op_and_module_has_a_case() -> None:
    assert not without_a_case(), "give these inputs in tests/embedded.py"


@pytest.mark.usefixtures("each_form", "restored")
@pytest.mark.parametrize("name", CASES)
def test_default_dtype_and_device(name: str) -> None:
    case, wanted = CASES[name], expected(name)
    for dtype, device in ((torch.float64, None), (torch.bfloat16, None), (torch.float32, "meta")):
        # Tensors that ops keep from call to call may come from before the defaults changed.
        otsu._bin_of_level.cache_clear()
        apparent_contact._kept_boxes.cache_clear()
        torch.set_default_dtype(dtype)
        torch.set_default_device(device)
        with torch.no_grad():
            for result, other in zip(tensors_of(case.call(*case.inputs)), wanted, strict=True):
                assert result.dtype == other.dtype
                assert result.device == other.device
                assert torch.equal(result.nan_to_num(-7.0), other.nan_to_num(-7.0))


def test_ops_are_independent_of_default_dtype_and_device_at_import() -> None:
    """Tensors made once, at import or in the first call, have their own dtype and device whatever the defaults are
    then.
    """
    code = """
import torch
torch.set_default_dtype(torch.float64)
torch.set_default_device("meta")
import fingerflow.ops
import fingerflow.graphs
from fingerflow.graphs import FieldsGraph, GrossEllipse

cpu = dict(dtype=torch.float32, device="cpu")
frame = torch.arange(64, dtype=torch.uint8, device="cpu").repeat(64, 1)[None, None]
places = torch.meshgrid(torch.arange(8, **cpu), torch.arange(8, **cpu), indexing="ij")
points = torch.stack(places, -1).reshape(1, 64, 2)
ellipse = GrossEllipse(torch.full((1, 2), 4.0, **cpu), torch.full((1, 2), 3.0, **cpu), torch.zeros(1, **cpu))
fields = FieldsGraph(6.0)(points, points / 10, None, ellipse)
assert fields.median.dtype == torch.float32 and abs(fields.median[0, 0].item() - 0.2) < 0.02, fields.median
assert fingerflow.ops.otsu_threshold(frame).item() == 31
assert fingerflow.ops.median_filter(frame, 3).sum().item() == 64 * 32 * 63
print("the same")
"""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ran.stdout == "the same\n", ran.stderr
