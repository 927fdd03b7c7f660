"""The compiled twins of some ops: whether they serve, and one typed function for each.

They serve plain tensors on the processor, outside tracing, export and autograd, and give what the portable op gives,
bit for bit, or to rounding where a docstring says so. While torch compiles they are ops of its own.
`FINGERFLOW_KERNELS=0` in the environment turns them off. Where they were not built, because no C++ compiler was there
at install time, the portable ops serve and a log message of level INFO says so once.
"""

from fingerflow.kernels.checks import FRAME_KINDS
from fingerflow.kernels.contact import (
    CELLS,
    COUNTED_DTYPES,
    LARGEST_MAJORITY,
    LARGEST_MEDIAN,
    MEDIAN_DTYPES,
    WIDEST_MOMENTS,
    apparent_contact,
    dilate,
    fill_holes,
    fit_ellipse,
    histogram,
    largest_component,
    light_gain,
    mask_moments,
    median,
    otsu_threshold,
    real_contact_mask,
)
from fingerflow.kernels.fields import FittedPlanes, area_medians, local_gradients, triangle_strain
from fingerflow.kernels.flow import flow_cycles, flow_warp
from fingerflow.kernels.library import inject_fault, limit_instruction_set, serve
from fingerflow.kernels.skin import press_skin, press_skin_back
from fingerflow.kernels.tracking import (
    LARGEST_CORNER_WINDOW,
    CornerPlaces,
    FollowedPoints,
    corners,
    find_templates,
    halve,
    mean_response,
    prepare_templates,
    search_windows,
)

__all__ = [
    "CELLS",
    "COUNTED_DTYPES",
    "FRAME_KINDS",
    "LARGEST_CORNER_WINDOW",
    "LARGEST_MAJORITY",
    "LARGEST_MEDIAN",
    "MEDIAN_DTYPES",
    "WIDEST_MOMENTS",
    "CornerPlaces",
    "FittedPlanes",
    "FollowedPoints",
    "apparent_contact",
    "area_medians",
    "corners",
    "dilate",
    "fill_holes",
    "find_templates",
    "fit_ellipse",
    "flow_cycles",
    "flow_warp",
    "halve",
    "histogram",
    "inject_fault",
    "largest_component",
    "light_gain",
    "limit_instruction_set",
    "local_gradients",
    "mask_moments",
    "mean_response",
    "median",
    "otsu_threshold",
    "prepare_templates",
    "press_skin",
    "press_skin_back",
    "real_contact_mask",
    "search_windows",
    "serve",
    "triangle_strain",
]
