"""Tests that kernels refuse arguments that do not fit their declarations, and name the wrong one."""

import inspect
import re
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch

from fingerflow.engines.engine import EngineSettings
from fingerflow.engines.native import NativeEngine
from fingerflow.kernels import flow, tracking
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.declarations import ArrayField, NumberField
from fingerflow.kernels.library import compiled, declared
from tests.kernels.kernel_calls import kernel_calls, reached
from tests.kernels.twins import TWINS

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

DECLARED = declared()
CALLS = kernel_calls() if kernels.serve() else {}
#: Arguments of one call of each kernel; those without one in `kernel_calls` have that of their twin.
ARGUMENTS = {name: values for call in CALLS.values() for name, values in reached(call).items()}
for name in TWINS.keys() & (DECLARED.keys() - ARGUMENTS.keys()):
    op, given = next(TWINS[name].calls())
    ARGUMENTS |= reached(partial(op, *given))


def twice(array: Any, axis: int) -> Any:
    join = np.concatenate if isinstance(array, np.ndarray) else torch.cat
    return join((array, array), axis)


def wrong_arguments(kernel: str) -> Iterator[tuple[str, Any, type[Exception] | tuple[type[Exception], ...]]]:
    """Yield arguments that do not fit a kernel, with the errors that they raise: of every array another dtype, one axis
    more, and each axis of a size that another argument tells; of every number one beyond its limits.
    """
    inputs = [field for field in DECLARED[kernel].fields if isinstance(field, ArrayField) and field.role != "result"]
    sizes = [size for field in inputs for size in field.shape if ARGUMENTS[kernel][field.name] is not None]
    for field in inputs:
        array = ARGUMENTS[kernel][field.name]
        if array is None:
            continue
        yield field.name, array.astype(np.int16) if isinstance(array, np.ndarray) else array.short(), TypeError
        yield field.name, array[None], ValueError
        if not field.optional:
            yield field.name, None, TypeError
        if field.below:
            yield field.name, array + 1000, ValueError
        for axis, size in enumerate(field.shape):
            if array.shape[axis] and not size.isidentifier() and "|" not in size:
                yield field.name, twice(array, axis), ValueError
            elif array.shape[axis] and sizes.count(size) > field.shape.count(size):
                yield "", {field.name: twice(array, axis)}, ValueError  # either array may be named
    for number in DECLARED[kernel].fields:
        limited = isinstance(number, NumberField) and number.least is not None and number.name in ARGUMENTS[kernel]
        if limited and not any(re.search(rf"\b{number.name}\b", size) for size in sizes):
            yield number.name, number.least - 1, ValueError
            yield number.name, number.most + 1, ValueError
            yield number.name, 1.5, TypeError
            if number.step > 1:
                yield number.name, number.least + 1, ValueError
            if number.among:
                yield number.name, 3, ValueError


@pytest.mark.parametrize("kernel", DECLARED)
def test_what_does_not_fit_its_declaration_is_refused(kernel: str) -> None:
    if kernel not in ARGUMENTS:
        assert kernel in ("limit_instruction_set", "inject_fault", "flow_descend", "flow_left")
        return
    for name, value, error in wrong_arguments(kernel):
        changed = {name: value} if name else value
        with pytest.raises(error, match=f"kernel {kernel}: {name or '.*'} (is|goes)"):
            compiled(kernel)(**{**ARGUMENTS[kernel], **changed})
    for name in ARGUMENTS[kernel]:
        with pytest.raises(TypeError, match=f"kernel {kernel} was called with"):
            compiled(kernel)(**{key: value for key, value in ARGUMENTS[kernel].items() if key != name}, unknown=1)


#: Kernel, arguments that fit by themselves and not together, and the number that is named.
UNRELATED: list[tuple[str, dict[str, Any], str]] = [
    ("find_templates", {"steps": 3}, "steps is 3: give batch == steps"),
    ("histogram", {"count": 255}, "count is 255"),
    ("histogram", {"bins": torch.zeros(10, dtype=torch.uint16)}, "count is 256"),
    ("contact_of_frames", {"radius": 1, "side": 8}, "side is 8: give side <= 2"),
    ("frame_distances", {"bands": 999}, "bands is 999: give bands <= lines"),
    ("find_outliers", {name: np.ones((16, 48), np.int32) for name in ("number",)}, "is"),
    ("detect_points", {"border": 2}, "border is 2: give a whole number from 3"),
    ("block_means", {"along": 0}, "along is 0"),
    ("search_and_return", {"size": (1 << 20) + 1}, "size is 1048577"),
    ("median", {"frames": [[1]]}, "frames is list"),
    ("median", {"size": "5"}, "size is '5'"),
]


@pytest.mark.parametrize(("kernel", "change", "words"), UNRELATED)
def test_numbers_that_do_not_fit_together_are_refused(kernel: str, change: dict[str, Any], words: str) -> None:
    with pytest.raises((TypeError, ValueError), match=words):
        compiled(kernel)(**{**ARGUMENTS[kernel], **change})


def test_planes_of_another_dtype_are_refused() -> None:
    planes = [torch.zeros(1, channels, 4 + rows, 5 + columns) for channels, rows, columns in flow._PLANES]
    flows = torch.zeros(1, 2, 4, 5), torch.zeros(1, 2, 4, 5), torch.zeros(1, 1, 4, 5)
    with pytest.raises(TypeError, match="a plane is float64"):
        flow.flow_descend([plane.double() for plane in planes], *flows, (0.25, 0.5, 0.25), 1, 1, 1, 0.5)


def test_tensors_on_other_devices_are_refused() -> None:
    with pytest.raises(ValueError, match="on meta: give tensors on the CPU"):
        kernels.median(torch.zeros(1, 1, 9, 9, dtype=torch.uint8, device="meta"), 3)


APART = torch.ones(2, 24, dtype=torch.bool), torch.zeros(2, 24, 5)
#: A function, new values of its arguments or functions that change them, and the message of a refusal of its own.
REFUSED: list[tuple[str, dict[str, Any], str]] = [
    ("histogram", {"bins": 10}, "10 bins for 256 levels"),
    ("histogram", {"bin_of_level": (torch.arange(256) // 15).to(torch.uint16), "bins": 16}, "from 0 to 17"),
    ("medians_over_area", {"reference": lambda points: points.repeat(3, 1, 1)}, "reference is"),
    ("medians_over_area", {"covariance": None, "apart": APART[0], "apart_fields": None}, "deviations"),
    (
        "medians_over_area",
        {"covariance": None, "apart": APART[0], "apart_fields": APART[1], "apart_std": APART[1]},
        "deviations",
    ),
    ("local_gradients", {"values": lambda values: values.repeat(3, 1, 1)[:3]}, "values is"),
    ("find_templates", {"frames": lambda frames: frames[[0, 1, 1]]}, "recordings"),
    ("correct_points", {"gauge_px": 0}, "gauge length of 0"),
    (
        "find_outliers",
        {"displacement": lambda moved: moved[:, :20], "position_std": lambda deviation: deviation[:, :20]},
        "20 points, and neighbours of up to 64",
    ),
]


@pytest.mark.parametrize(("name", "change", "words"), REFUSED)
def test_what_functions_check_themselves(name: str, change: dict[str, Any], words: str) -> None:
    call = CALLS[name]
    given = inspect.signature(call.function).bind(*call.arguments, **call.settings).arguments
    given |= {key: value(given[key]) if callable(value) else value for key, value in change.items()}
    with pytest.raises((TypeError, ValueError), match=words):
        call.function(**given)


@pytest.mark.parametrize(
    ("attempt", "words"),
    [
        (lambda: tracking.sizes_of(21, 1 << 16), "32768 in all"),
        (lambda: tracking.sizes_of(0, 3), "0 px windows"),
        (lambda: tracking.find_neighbours(np.zeros((1, 2), np.float32), 9.0), "1 points have no neighbours"),
        (lambda: NativeEngine(EngineSettings(gross_radius_px=1, cell_px=4)), "cells of 4 px"),
    ],
)
def test_sizes_that_cannot_be_are_refused(attempt: Callable[[], Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        attempt()
