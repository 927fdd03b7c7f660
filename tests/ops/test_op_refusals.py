"""Tests that ops refuse invalid arguments with an error that names the value found and the value needed."""

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch

from fingerflow import ops
from fingerflow.ops.contact.apparent_contact import apparent_contact
from fingerflow.ops.contact.otsu import histogram
from fingerflow.ops.contact.real_contact_mask import real_contact_mask
from fingerflow.ops.fields.area_medians import area_medians
from fingerflow.ops.fields.rigid_motion import rigid_residual
from fingerflow.ops.fields.strain_uncertainty import field_std
from fingerflow.ops.filters.morphology import dilate, erode
from fingerflow.ops.filters.noise import estimate_noise
from fingerflow.ops.filters.quantile import frame_quantile
from fingerflow.ops.tracking.contrast import subtract_background, unsharp_mask
from fingerflow.ops.tracking.outliers import find_neighbours

FRAMES, IMAGE, MASK = torch.zeros(2, 1, 9, 9), torch.ones(1, 1, 9, 9), torch.zeros(1, 1, 9, 9).bool()
POINTS, TRIANGLES, GRID = torch.zeros(2, 5, 2), torch.tensor([[0, 1, 2]]), torch.linspace(-1, 1, 3)
FIELD, GRADIENT, STRAIN = torch.ones(1, 2, 9, 9), torch.zeros(2, 2), torch.zeros(3)
MEASURES = "green_lagrange, as_printed, infinitesimal"

#: Valid arguments of each op.
FITTED: dict[Callable[..., Any], dict[str, Any]] = {
    area_medians: {
        **{"reference": POINTS[:1], "displacement": POINTS[:1], "center": torch.zeros(1, 2)},
        **{"semi_axes": torch.ones(1, 2), "angle": torch.zeros(1), "gauge_length": 1.0},
    },
    ops.detect_corners: {"frame": IMAGE},
    ops.dense_flow: {"first": FRAMES[:1], "current": FRAMES[:1]},
    ops.helmholtz_hodge: {"field": FIELD},
    ops.local_gradients: {"points": POINTS, "values": POINTS, "gauge_length": 1.0},
    ops.normalize_illumination: {"frames": FRAMES, "reference": FRAMES},
    ops.scattered_to_grid: {
        **{"points": POINTS, "values": POINTS, "grid_x": GRID, "grid_y": GRID[:2], "gauge_length": 1.0},
    },
    ops.strain_energy_density: {"strain": STRAIN},
    ops.track_points: {"previous": FRAMES, "current": FRAMES, "points": POINTS},
    ops.triangle_gradients: {"points": POINTS, "triangles": TRIANGLES, "values": POINTS},
    real_contact_mask: {"frames": FRAMES, "light": IMAGE, "black": IMAGE, "limit": torch.zeros(2)},
    rigid_residual: {"points": POINTS, "displacement": POINTS},
}

#: (op, arguments that are changed, pattern of the error message).
REFUSED: list[tuple[Callable[..., Any], dict[str, Any], str]] = [
    (ops.normalize_illumination, {"reference": IMAGE.repeat(3, 1, 1, 1)}, r"reference has shape \(3, 1, 9, 9\)"),
    (ops.normalize_illumination, {"dark": IMAGE[..., 1:]}, r"dark has shape \(1, 1, 9, 8\)"),
    (ops.normalize_illumination, {"frames": IMAGE[0, 0]}, r"frames has shape \(9, 9\)"),
    (ops.normalize_illumination, {"minimum_illumination": 1.5}, r"minimum_illumination is 1\.5"),
    *[(ops.median_filter, {"frames": IMAGE.to(kind)}, str(kind)) for kind in (torch.bool, torch.complex64)],
    (ops.median_filter, {"frames": IMAGE[0, 0]}, r"\(9, 9\).*\(B, 1, H, W\)"),
    (ops.median_filter, {"frames": torch.zeros(1, 3, 9, 9)}, r"\(1, 3, 9, 9\)"),
    (ops.median_filter, {"frames": IMAGE, "size": 4}, "4 x 4.*odd"),
    (erode, {"mask": MASK, "radius": -1}, "radius is -1"),
    (dilate, {"mask": MASK, "radius": 1, "shape": "square"}, "square"),
    (frame_quantile, {"frames": IMAGE, "fraction": 1.5}, r"1\.5"),
    (apparent_contact, {"mask": MASK.byte(), "radius": 3}, "uint8"),
    (apparent_contact, {"mask": MASK[0], "radius": 3}, "shape"),
    *[(apparent_contact, {"mask": MASK, "radius": radius}, f"radius of {radius} px") for radius in (0, 256)],
    (apparent_contact, {"mask": MASK, "radius": 3, "cell": 8}, "cells of 8 px"),
    (histogram, {"frames": IMAGE, "value_range": (1, 1)}, r"\(1, 1\): high must be above low"),
    (ops.otsu_threshold, {"frames": IMAGE[0, 0]}, r"\(9, 9\)"),
    *[
        (ops.otsu_threshold, {"frames": IMAGE.to(kind)}, "value_range")
        for kind in (torch.uint16, torch.float32, torch.int32)
    ],
    (real_contact_mask, {"frames": FRAMES[0]}, "frames have shape"),
    (real_contact_mask, {"black": IMAGE[..., 1:]}, "black has shape"),
    (real_contact_mask, {"median_px": 4}, "4 x 4"),
    (real_contact_mask, {"limit": torch.zeros(3)}, "one number a frame"),
    (estimate_noise, {"images": IMAGE[..., :2]}, r"frames of \(9, 2\) px"),
    (unsharp_mask, {"frames": IMAGE, "sigma": 0}, "sigma is 0"),
    (
        subtract_background,
        {"frames": FRAMES, "background": torch.zeros(3, 1, 9, 9)},
        r"\(3, 1, 9, 9\)",
    ),
    (ops.detect_corners, {"count": -1}, "count -1"),
    (ops.detect_corners, {"quality": 1.5}, r"quality 1\.5"),
    (ops.detect_corners, {"min_distance": math.nan}, "min_distance nan"),
    (ops.detect_corners, {"window": 4}, "window is 4"),
    (ops.detect_corners, {"frame": IMAGE[0, 0]}, r"\(9, 9\)"),
    (ops.detect_corners, {"frame": IMAGE[..., :2, :]}, "noise="),
    (ops.dense_flow, {"first": FRAMES[0]}, "first must be"),
    (ops.dense_flow, {"current": FRAMES[:1, ..., 1:]}, "current must be"),
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
    (ops.track_points, {"points": POINTS.long()}, "floating"),
    (ops.track_points, {"current": FRAMES[..., 1:]}, "same shape"),
    (ops.track_points, {"initial": POINTS[:, 1:]}, "initial"),
    (ops.track_points, {"warp": POINTS}, "warp"),
    (ops.track_points, {"noise": torch.zeros(3)}, "noise"),
    (find_neighbours, {"positions": POINTS[:, :1], "gauge_length": 1.0}, "1 points have no neighbours"),
    (area_medians, {"displacement": POINTS[:1].int()}, "values must be floating"),
    (area_medians, {"displacement": torch.zeros(1, 5, 3)}, "displacement"),
    (area_medians, {"displacement": POINTS[:1, 1:]}, "points"),
    (area_medians, {"reference": POINTS}, "reference has 2 frames"),
    (area_medians, {"center": torch.zeros(2, 2)}, "center must be"),
    (area_medians, {"angle": torch.zeros(1, 1)}, "angle must be"),
    (area_medians, {"covariance": torch.zeros(1, 5)}, "covariance must be"),
    (area_medians, {"measure": "hencky"}, f"'hencky'.*{MEASURES}"),
    (ops.green_lagrange, {"gradient": GRADIENT, "measure": "almansi"}, f"'almansi'.*{MEASURES}"),
    (field_std, {"gradient": GRADIENT, "covariance": torch.zeros(2, 2, 2, 2), "measure": "hencky"}, MEASURES),
    *[(area_medians, {"gauge_length": gauge}, "gauge_length must be") for gauge in (0.0, math.nan)],
    (ops.scattered_to_grid, {"grid_y": GRID[None]}, r"grid_y .*\(1, 3\)"),
    (ops.scattered_to_grid, {"mask": torch.ones(1, 1, 2, 3)}, r"torch.float32 \(1, 1, 2, 3\)"),
    (ops.scattered_to_grid, {"mask": MASK}, r"\(B, 1, 2, 3\), found torch.bool \(1, 1, 9, 9\)"),
    *[(ops.local_gradients, {"gauge_length": gauge}, f"found {gauge}") for gauge in (0.0, -1.0, math.nan, math.inf)],
    (ops.local_gradients, {"minimum_points": 2}, "found 2"),
    (ops.local_gradients, {"values": POINTS.long()}, "int64"),
    (ops.local_gradients, {"queries": torch.zeros(2, 5, 3)}, r"\(2, 5, 3\)"),
    (ops.local_gradients, {"queries": torch.zeros(3, 5, 2)}, "queries 3"),
    (ops.local_gradients, {"variance": POINTS}, r"\(2, 5, 2\)"),
    (ops.local_gradients, {"variance": torch.zeros(3, 5)}, "variance 3"),
    (ops.triangle_gradients, {"points": POINTS.long()}, "int64"),
    (ops.triangle_gradients, {"triangles": TRIANGLES.double()}, "float64"),
    (ops.triangle_gradients, {"points": POINTS[0]}, r"\(5, 2\)"),
    (ops.triangle_gradients, {"triangles": TRIANGLES[:, :2]}, r"\(1, 2\)"),
    (ops.triangle_gradients, {"values": POINTS[:, 1:]}, r"\(2, 4, 2\)"),
    (ops.triangle_gradients, {"values": torch.zeros(3, 5, 2)}, "points 2, values 3"),
    (ops.triangle_gradients, {"minimum_quality": 1.5}, r"1\.5"),
    (rigid_residual, {"displacement": torch.zeros(2, 5, 3)}, r"\(2, 5, 3\)"),
    (rigid_residual, {"weights": torch.ones(1, 4)}, r"\(1, 4\)"),
    (ops.helmholtz_hodge, {"field": FIELD.long()}, r"floating, found torch\.int64"),
    (ops.helmholtz_hodge, {"field": torch.ones(1, 3, 9, 9)}, r"\(B, 2, H, W\), found \(1, 3, 9, 9\)"),
    (ops.helmholtz_hodge, {"mask": IMAGE}, r"bool, found torch\.float32"),
    (ops.helmholtz_hodge, {"mask": MASK[..., 1:]}, r"\(1, 1, 9, 9\), found \(1, 1, 9, 8\)"),
    (ops.divergence, {"gradient": torch.zeros(3, 2)}, r"\(3, 2\)"),
    (ops.strain_energy_density, {"strain": torch.zeros(4, 2)}, r"\(4, 2\)"),
    *[
        (ops.strain_energy_density, {"poisson_ratio": ratio}, f"found {ratio}")
        for ratio in (0.5, 0.7, -1.0, -2.0, math.nan)
    ],
    *[
        (ops.strain_energy_density, {"young_modulus_mpa": modulus}, f"found {modulus}")
        for modulus in (0.0, -1.0, math.inf, math.nan)
    ],
]


@pytest.mark.parametrize(("op", "change", "words"), REFUSED)
def test_the_error_names_what_was_found(op: Callable[..., Any], change: dict[str, Any], words: str) -> None:
    with pytest.raises((TypeError, ValueError), match=words):
        op(**{**FITTED.get(op, {}), **change})
