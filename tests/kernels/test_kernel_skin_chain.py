"""Tests of the compiled skin chain against the portable one: the same steps, and the same numbers to rounding."""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import pytest
import torch

from fingerflow.kernels import tensors as kernels
from fingerflow.models.skin_chain import PressedChain, press
from fingerflow.models.skin_parameters import PARAMETERS

Portable = Callable[[Callable[[], object]], Any]
FRICTIONS = torch.tensor([0.0, 0.03, 0.1, 0.3, 0.5, 0.8, 1.0, 1.3, 2.0], dtype=torch.float64)  # more than a register


PORTABLE: dict[object, Any] = {}  # result of each case, the same for all instruction sets


def once(portable: Portable, case: object, call: Callable[[], object]) -> Any:
    if case not in PORTABLE:
        PORTABLE[case] = portable(call)
    return PORTABLE[case]


def same(found: PressedChain, expected: PressedChain) -> None:
    assert torch.equal(found.steps, expected.steps)
    for field in fields(PressedChain):
        one, other = getattr(found, field.name), getattr(expected, field.name)
        size = other.nan_to_num(0.0).abs().max().item()
        limit = {"balance": 1e-7}.get(field.name, 1e-7 * size)
        torch.testing.assert_close(one, other, rtol=0, atol=limit, equal_nan=True)


@pytest.mark.parametrize("elements", [5, 40])
def test_compiled_press_of_the_chain_agrees_with_the_portable_form(
    instruction_set: int, portable: Portable, torch_threads: Callable[[int], None], elements: int
) -> None:
    torch_threads(1)
    found = press(FRICTIONS, elements=elements, tangential_n=0.05)
    same(found, once(portable, elements, lambda: press(FRICTIONS, elements=elements, tangential_n=0.05)))
    torch_threads(2)
    again = press(FRICTIONS, elements=elements, tangential_n=0.05)
    assert torch.equal(again.position, found.position)
    one = press(FRICTIONS[5], elements=elements, tangential_n=0.05)
    torch.testing.assert_close(one.position, found.position[5], rtol=0, atol=1e-13)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 1.5])
def test_compiled_friction_laws_agree_with_the_portable_form(
    instruction_set: int, portable: Portable, exponent: float
) -> None:
    skin = replace(PARAMETERS["lab"], friction_exponent=exponent)

    def call() -> PressedChain:
        return press(torch.tensor([0.2, 0.6]), skin, elements=21)

    same(call(), once(portable, exponent, call))


def test_steps_that_never_keep_the_tolerance_end(instruction_set: int, portable: Portable) -> None:
    def lost() -> None:
        with pytest.raises(RuntimeError, match="raise the tolerance"):
            press(0.3, elements=5, tolerance_m=1e-30)

    lost()
    portable(lost)


def test_what_does_not_belong_together_is_refused() -> None:
    count, kind = 5, torch.float64
    reference = torch.zeros(1, count, 2, dtype=kind)
    state = [torch.zeros(shape, dtype=kind) for shape in ((1, count, 2), (1, 2), (1, count), (1,))]
    numbers, mu, load = (torch.zeros(shape, dtype=kind) for shape in ((1, 10), (1, count), (1, 2, 2)))
    rest = torch.zeros(1, dtype=kind)
    settings: dict[str, Any] = {"most_steps": 0, "tolerance": 1.0, "duration": 1.0}
    with pytest.raises(ValueError, match="numbers is"):
        kernels.press_skin(reference, numbers[:, :9], mu, load, rest, *state, **settings)
    with pytest.raises(ValueError, match="place is"):
        kernels.press_skin(reference, numbers, mu, load, rest, state[0].float(), *state[1:], **settings)
    few = [state[0][:, :2], state[1], state[2][:, :2], state[3]]
    with pytest.raises(ValueError, match="2 elements"):
        kernels.press_skin(reference[:, :2], numbers, mu[:, :2], load, rest, *few, **settings)
