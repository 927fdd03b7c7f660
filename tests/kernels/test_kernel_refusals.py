"""Tests that every function of kernels refuses arguments that do not fit together, and names the wrong one."""

import inspect
from typing import Any

import numpy as np
import pytest
import torch

from fingerflow.kernels import tensors as kernels
from tests.kernels.kernel_calls import kernel_calls

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

CALLS = kernel_calls() if kernels.serve() else {}
APART = torch.ones(2, 24, dtype=torch.bool), torch.zeros(2, 24, 5)


def double(value: Any) -> Any:
    return value.astype(np.float64) if isinstance(value, np.ndarray) else value.double()


def narrower(value: Any) -> Any:
    return value[..., 1:]


def shorter(value: Any) -> Any:
    return value[:-1]


def longer(value: Any) -> Any:
    return value.repeat(2, 0) if isinstance(value, np.ndarray) else torch.cat((value, value))


def as_bytes(value: Any) -> Any:
    return value.view(np.uint8) if isinstance(value, np.ndarray) else value.byte()


#: A function, new values of its arguments or functions that change them, and the message of the refusal.
REFUSED: list[tuple[str, dict[str, Any], str]] = [
    ("median", {"frames": torch.Tensor.float}, "float32"),
    ("median", {"frames": lambda one: one[0]}, r"give \(B, 1, H, W\)"),
    *[("median", {"size": size}, f"{size} was asked for") for size in (-1, 1, 4, 33)],
    ("normalize", {"least": longer}, "least"),
    ("normalize", {"light": narrower}, "light of"),
    ("sample_windows", {"images": double}, "float64"),
    ("sample_windows", {"image_index": lambda one: one + 2}, "image_index"),
    ("sample_windows", {"places": double}, "places"),
    ("sample_windows", {"warp": shorter}, "warp"),
    ("sample_windows", {"images": lambda one: one[..., :3]}, "windows of 9 px"),
    ("search_windows", {"images": narrower}, "images"),
    ("search_windows", {"image_index": lambda one: one + 1}, "image_index"),
    ("search_windows", {"guess": double}, "guess"),
    ("search_windows", {"size": 30}, "30"),
    ("search_windows", {"size": (1 << 22) + 1}, "ends at 32768 px"),
    *[("real_contact_mask", {"size": size}, f"{size} was asked for") for size in (0, 2, 17)],
    ("real_contact_mask", {"limits": longer}, "limits is"),
    ("real_contact_mask", {"light": double}, "float64"),
    ("illumination_gain", {"black": narrower}, "black of"),
    ("illumination_gain", {"side": 12}, "multiples of 8"),
    ("histogram", {"frames": torch.Tensor.int}, "int32"),
    ("histogram", {"bins": 10}, "10 bins for 256 levels"),
    ("histogram", {"mask": longer}, "a mask of"),
    ("histogram", {"bin_of_level": (torch.arange(256) // 15).to(torch.uint16), "bins": 16}, "goes up to 17"),
    ("apparent_contact", {"side": 3}, "cells of 3 px"),
    ("apparent_contact", {"mask": as_bytes}, "uint8"),
    ("medians_over_area", {"reference": lambda one: one.repeat(3, 1, 1)}, "reference"),
    ("medians_over_area", {"displacement": double}, "displacement is"),
    ("medians_over_area", {"covariance": shorter}, "covariance"),
    ("medians_over_area", {"covariance": None, "apart": APART[0], "apart_fields": APART[1][:1]}, "apart_fields"),
    (
        "medians_over_area",
        {"covariance": None, "apart": APART[0], "apart_fields": APART[1], "apart_std": APART[1]},
        "deviations",
    ),
    ("medians_over_area", {"measure": 3}, "measure 3"),
    ("local_gradients", {"values": double}, "values"),
    ("local_gradients", {"points": narrower}, "points"),
    ("local_gradients", {"noise": narrower}, "noise"),
    ("local_gradients", {"values": longer}, "batches"),
    ("strain_of_triangles", {"triangles": lambda one: one + 99}, "triangles of 24 points"),
    ("strain_of_triangles", {"covariance": shorter}, "covariance is"),
    ("strain_of_triangles", {"displacement": double}, "displacement is"),
    ("prepare_templates", {"image": double}, "float64"),
    ("prepare_templates", {"points": narrower}, "points"),
    ("prepare_templates", {"inverse_warp": torch.zeros(2, 24, 2)}, "inverse_warp"),
    ("prepare_templates", {"variance": shorter}, "variance"),
    ("prepare_templates", {"window": 8}, "window"),
    ("prepare_templates", {"image": lambda one: one[..., :3]}, "frames"),
    ("find_templates", {"frames": double}, "float64"),
    ("find_templates", {"place": lambda one: one[:, 1:]}, "start"),
    ("find_templates", {"speed": torch.zeros(2, 2, 2)}, "speed"),
    ("find_templates", {"variance": torch.zeros(3)}, "variance"),
    ("find_templates", {"templates": lambda one: [one[0], narrower(one[1]), *one[2:]]}, "samples|window"),
    ("find_templates", {"frames": lambda one: one[[0, 1, 1]]}, "recordings"),
    *[("contact_of_frames", {"median_px": size}, "odd sizes") for size in (4, 17)],
    ("contact_of_frames", {"radius": 0}, "radius"),
    ("contact_of_frames", {"cell": 3}, "cells of 3 px"),
    ("contact_of_frames", {"limits": shorter}, "limits is"),
    ("contact_of_frames", {"black": double}, "black is float64"),
    ("contact_of_frames", {"frames": lambda one: one.astype(">u2")}, "frames are >u2"),
    ("contact_of_frames", {"frames": lambda one: one[:, 0]}, r"give \(B, 1, H, W\)"),
    ("contact_threshold", {"light": narrower}, "light of"),
    ("contact_threshold", {"gains": np.zeros(1, np.float32)}, "gains is"),
    ("contact_threshold", {"stride_px": 0}, "one pixel of 0"),
    ("covered", {"points": narrower}, "points is"),
    ("covered", {"transform": narrower}, "transform is"),
    ("covered", {"density_margin": lambda one: one[:, :, :0]}, "density_margin"),
    ("block_means", {"blocks": (999, 999)}, "blocks of"),
    ("block_means", {"frames": double}, "float64"),
    *[("shift_windows", {"now": change}, "now is") for change in (double, shorter)],
    ("shift_windows", {"then": lambda one: one[:, :0]}, "no sample"),
    ("shift_windows", {"around": shorter}, "around is"),
    *[("frame_distances", {"before": change}, "before is") for change in (double, shorter, narrower)],
    *[("frame_distances", {"bands": bands}, "bands of") for bands in (0, 999)],
    ("shift_windows", {"weight": narrower}, "weight is"),
    ("shift_windows", {"shift": narrower}, "shift is"),
    *[
        ("correct_points", {name: change}, f"{name} is")
        for name in ("start", "points", "covariance", "numbers", "inverse_warp")
        for change in (double, narrower)
    ],
    ("correct_points", {"gauge_px": 0}, "gauge length of 0"),
    ("find_outliers", {"displacement": double}, "displacement is float64"),
    ("find_outliers", {"position_std": shorter}, "position_std is"),
    (
        "find_outliers",
        {"displacement": lambda one: one[:, :20], "position_std": lambda one: one[:, :20]},
        "20 points, and neighbours of 49 to 64",
    ),
    (
        "find_outliers",
        {"neighbours": lambda one: one._replace(number=one.number + 9)},
        "there are 60 points",
    ),
    ("search_and_return", {"current": narrower}, "two of one shape"),
    ("search_and_return", {"key": double}, "float64"),
    ("search_and_return", {"guess": shorter}, "guess is"),
    ("search_and_return", {"image_index": np.ones(60, np.int64)}, "from 0 to 0"),
    ("search_and_return", {"radius": 1 << 16}, "32768 px"),
    ("detect_points", {"frame": double}, "float64"),
    ("detect_points", {"frame": longer}, "2, 1, 256, 80"),
    ("detect_points", {"frame": lambda one: one[..., :6], "mask": lambda one: one[:, :6]}, "7 x 7 px"),
    ("detect_points", {"mask": narrower}, "a mask of"),
    ("detect_points", {"mask": as_bytes}, "uint8"),
    ("detect_points", {"count": 0}, "0 points"),
    ("detect_points", {"window": -1}, "windows of -1 px"),
    ("detect_points", {"min_distance_px": np.inf}, "inf px apart"),
    ("find_templates", {"templates": lambda one: one[:2]}, "2 arrays are no templates"),
    ("find_pairs", {"window": 4097}, "not 4097"),
    ("apparent_contact", {"radius": 256}, "radius of 256"),
    ("median", {"frames": lambda one: one.to("meta")}, "data is on meta: give tensors on the CPU"),
    ("local_gradients", {"minimum_points": -1}, "minimum_points is -1: give a whole number from 0"),
    ("local_gradients", {"minimum_points": 1.5}, "minimum_points is 1.5: give a whole number"),
    ("find_templates", {"rounds": 1 << 40}, r"rounds is 1099511627776: give a whole number from 0 to 2\^31 - 1"),
]


@pytest.mark.parametrize(("name", "change", "words"), REFUSED)
def test_what_does_not_fit_is_refused(name: str, change: dict[str, Any], words: str) -> None:
    call = CALLS[name]
    given = inspect.signature(call.function).bind(*call.arguments, **call.settings).arguments
    given |= {key: value(given[key]) if callable(value) else value for key, value in change.items()}
    with pytest.raises((TypeError, ValueError), match=words):
        call.function(**given)
