"""Functions of kernels as torch ops, `torch.ops.fingerflow.<name>`, and the dtypes and sizes that they take."""

from collections.abc import Iterable

import torch

from fingerflow.kernels import checks, contact, deformation, fields, flow, skin, tracking
from fingerflow.kernels.tensors.torch_op import torch_op

__all__ = [
    "CELLS",
    "COUNTED_DTYPES",
    "FRAME_KINDS",
    "LARGEST_CORNER_WINDOW",
    "LARGEST_MAJORITY",
    "LARGEST_MEDIAN",
    "MEDIAN_DTYPES",
    "WIDEST_MOMENTS",
    "apparent_contact",
    "area_medians",
    "corners",
    "correct_points",
    "dilate",
    "fill_holes",
    "find_pairs",
    "find_templates",
    "fit_ellipse",
    "flow_at_pixels",
    "flow_covariance",
    "flow_descend",
    "flow_integrate",
    "flow_left",
    "flow_levels",
    "flow_template",
    "flow_to_pixels",
    "halve",
    "histogram",
    "largest_component",
    "level_shapes",
    "light_gain",
    "local_gradients",
    "mask_moments",
    "mean_response",
    "median",
    "normalize",
    "otsu_threshold",
    "prepare_templates",
    "press_skin",
    "press_skin_back",
    "real_contact_mask",
    "sample_windows",
    "search_windows",
    "spline_coefficients",
    "triangle_strain",
]


def _dtypes(kinds: Iterable[str]) -> tuple[torch.dtype, ...]:
    return tuple(getattr(torch, kind) for kind in kinds)


FRAME_KINDS = _dtypes(checks.FRAME_KINDS)
CELLS = contact.CELLS
COUNTED_DTYPES = _dtypes(contact.COUNTED_KINDS)
LARGEST_MAJORITY = contact.LARGEST_MAJORITY
LARGEST_MEDIAN = contact.LARGEST_MEDIAN
MEDIAN_DTYPES = _dtypes(contact.MEDIAN_KINDS)
WIDEST_MOMENTS = contact.WIDEST_MOMENTS
apparent_contact = torch_op()(contact.apparent_contact)
dilate = torch_op()(contact.dilate)
fill_holes = torch_op()(contact.fill_holes)
fit_ellipse = torch_op()(contact.fit_ellipse)
histogram = torch_op()(contact.histogram)
largest_component = torch_op()(contact.largest_component)
light_gain = torch_op()(contact.light_gain)
mask_moments = torch_op()(contact.mask_moments)
median = torch_op()(contact.median)
normalize = torch_op()(contact.normalize)
otsu_threshold = torch_op()(contact.otsu_threshold)
real_contact_mask = torch_op()(contact.real_contact_mask)
correct_points = torch_op()(deformation.correct_points)
area_medians = torch_op()(fields.area_medians)
local_gradients = torch_op()(fields.local_gradients)
triangle_strain = torch_op()(fields.triangle_strain)
flow_at_pixels = torch_op()(flow.flow_at_pixels)
flow_covariance = torch_op()(flow.flow_covariance)
flow_descend = torch_op()(flow.flow_descend)
flow_integrate = torch_op()(flow.flow_integrate)
flow_left = torch_op()(flow.flow_left)
flow_levels = torch_op()(flow.flow_levels)
flow_template = torch_op()(flow.flow_template)
flow_to_pixels = torch_op()(flow.flow_to_pixels)
level_shapes = flow.level_shapes
press_skin = torch_op(changes=("place", "bone", "rubbed", "step"))(skin.press_skin)
press_skin_back = torch_op()(skin.press_skin_back)
LARGEST_CORNER_WINDOW = tracking.LARGEST_CORNER_WINDOW
corners = torch_op()(tracking.corners)
find_pairs = torch_op()(tracking.find_pairs)
find_templates = torch_op()(tracking.find_templates)
halve = torch_op()(tracking.halve)
mean_response = torch_op()(tracking.mean_response)
prepare_templates = torch_op()(tracking.prepare_templates)
sample_windows = torch_op()(tracking.sample_windows)
search_windows = torch_op()(tracking.search_windows)
spline_coefficients = torch_op()(tracking.spline_coefficients)
