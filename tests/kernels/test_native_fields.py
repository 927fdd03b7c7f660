"""Tests of fields of frames from NumPy arrays against the fields graph."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from fingerflow.engines.engine import EngineSettings, EnteredPoints, FrameEllipse, FrameFields
from fingerflow.engines.native import NativeEngine
from fingerflow.graphs import fields_graph as graphs
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.field_limits import STRAIN_MEASURES

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

Array = np.ndarray[Any, Any]
Portable = Callable[[Callable[[], object]], Any]
FRAMES, GAUGE = 5, 2.0


class Case:
    """Points in a square of 12 x 12 whose displacements grow from frame to frame, some of them lost, and ellipses."""

    def __init__(self, points: int, *, noisy: bool, entered: bool) -> None:
        random = np.random.default_rng(points)
        place = 12 * random.random((1, points, 2)) - 6
        growth = 0.01 * np.arange(1, FRAMES + 1)[:, None, None]
        moved = growth * place @ np.array([[1.0, 0.3], [-0.5, 0.8]]) + 0.01 * random.standard_normal(
            (FRAMES, points, 2)
        )
        moved[:, ::11] = np.nan
        moved[2, 1::7, 0] = np.nan
        place[:, 3:4] = np.nan
        self.reference, self.displacement = place.astype(np.float32), moved.astype(np.float32)
        self.ellipse = FrameEllipse(
            random.uniform(-0.5, 0.5, (FRAMES, 2)).astype(np.float32),
            np.array([[4.5, 3.0], [2.0, 1.0], [0.3, 0.2], [0.0, 1.0], [30.0, 20.0]], np.float32),
            random.uniform(-3, 3, FRAMES).astype(np.float32),
        )
        root = 0.02 * random.standard_normal((FRAMES, points, 2, 2))
        self.covariance = (root @ root.swapaxes(2, 3)).astype(np.float32) if noisy else None
        self.entered = None
        if entered:
            among = np.broadcast_to(place[..., 0] < -2, (FRAMES, points)) & (random.random((FRAMES, points)) < 0.8)
            gradient = 0.1 * random.standard_normal((FRAMES, points, 2, 2)).astype(np.float32)
            gradient[random.random((FRAMES, points)) < 0.2] = np.nan
            root = 0.02 * random.standard_normal((FRAMES, points, 4, 4))
            spread = (root @ root.swapaxes(2, 3)).reshape(FRAMES, points, 2, 2, 2, 2).astype(np.float32)
            self.entered = EnteredPoints(among, gradient, spread if noisy else None)

    def found(self, measure: str) -> FrameFields:
        engine = NativeEngine(EngineSettings(gauge_length_mm=GAUGE, strain=measure))
        return engine.fields(self.reference[0], self.displacement, self.ellipse, self.covariance, self.entered)

    def expected(self, measure: str, precision: torch.dtype = torch.float32) -> FrameFields:
        def tensor(array: Any) -> Any:
            if array is None or array.dtype == np.bool_:
                return None if array is None else torch.from_numpy(array)
            return torch.from_numpy(array).to(precision)

        entered = None if self.entered is None else EnteredPoints(*map(tensor, self.entered))
        ellipse = FrameEllipse(*map(tensor, self.ellipse))
        given = (tensor(one) for one in (self.reference, self.displacement, self.covariance))
        result: FrameFields = graphs.FieldsGraph(GAUGE, measure)(*given, ellipse, entered)
        return result


def same(found: FrameFields, expected: FrameFields, atol: dict[str, float], rtol: float) -> None:
    for name, one, other in zip(FrameFields._fields, found, expected, strict=True):
        assert (one is None) == (other is None), name
        if one is not None and other is not None:
            assert one.dtype == np.float32
            assert one.shape == tuple(other.shape), name
            np.testing.assert_allclose(one, other.numpy(), rtol, atol.get(name, atol[""]), equal_nan=True, err_msg=name)


@pytest.mark.parametrize(
    ("points", "measure"),
    [*((700, one) for one in STRAIN_MEASURES), *((count, "green_lagrange") for count in (60, 4, 0))],
)
@pytest.mark.parametrize("entered", [False, True])
@pytest.mark.parametrize("noisy", [False, True])
def test_compiled_fields_agree_with_the_portable_form(
    portable: Portable, points: int, noisy: bool, entered: bool, measure: str
) -> None:
    """With compiled kernels, fields agree to the rounding of cosines and of sums of four numbers. Against the portable
    form in float64 they agree to the rounding of fits, some of which, at the border, have points on one side only.
    """
    case = Case(points, noisy=noisy, entered=entered)
    found = case.found(measure)
    same(found, case.expected(measure), {"": 1e-6}, 1e-5)
    if points == 700:
        assert np.isfinite(found.divergence).mean() > 0.7
        assert np.isfinite(found.median).sum() >= 10
    if entered:
        return  # a position between two points may have the field of either
    # A position at a limit may count in one form only: one rank of 800, and its share.
    limits = {"": 1e-5, "median": 1e-4, "median_std": 1e-4, "known_share": 3 / 800}
    same(found, portable(lambda: case.expected(measure, torch.float64)), limits, 1e-3)
