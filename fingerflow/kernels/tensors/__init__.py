"""Compiled kernels as torch ops; `serve` checks whether they can be used in place of other ops.

They take plain tensors on the CPU, outside tracing, export and autograd. Their results equal those of the portable op
bit for bit, or to rounding where a docstring says so. While torch compiles they are registered ops,
`torch.ops.fingerflow.<name>`. `FINGERFLOW_KERNELS=0` in the environment turns them off. If they were not built, for
lack of a C++ compiler at install time, the portable ops are used and a log message of level INFO reports it once.
"""

from collections.abc import Iterable

import torch

from fingerflow.kernels import checks, contact, deformation, fields, flow, tracking
from fingerflow.kernels.library import inject_fault as inject_fault
from fingerflow.kernels.library import limit_instruction_set as limit_instruction_set
from fingerflow.kernels.tensors.serving import constant_to_compiler as constant_to_compiler
from fingerflow.kernels.tensors.serving import fused_serves as fused_serves
from fingerflow.kernels.tensors.serving import fused_tracking_serves as fused_tracking_serves
from fingerflow.kernels.tensors.serving import serve as serve
from fingerflow.kernels.tensors.serving import twin_serves as twin_serves
from fingerflow.kernels.tensors.torch_op import torch_op


def _dtypes(kinds: Iterable[str]) -> tuple[torch.dtype, ...]:
    return tuple(getattr(torch, kind) for kind in kinds)


FRAME_KINDS = _dtypes(checks.FRAME_KINDS)
CELLS = contact.CELLS
COUNTED_DTYPES = _dtypes(contact.COUNTED_LEVELS)
LARGEST_MAJORITY = contact.LARGEST_MAJORITY
LARGEST_MEDIAN = contact.LARGEST_MEDIAN
MEDIAN_DTYPES = _dtypes(contact.MEDIAN_KINDS)
apparent_contact = torch_op()(contact.apparent_contact)
histogram = torch_op()(contact.histogram)
illumination_gain = torch_op()(contact.illumination_gain)
median = torch_op()(contact.median)
normalize = torch_op()(contact.normalize)
real_contact_mask = torch_op()(contact.real_contact_mask)
correct_points = torch_op()(deformation.correct_points)
area_medians = torch_op()(fields.area_medians)
local_gradients = torch_op()(fields.local_gradients)
triangle_strain = torch_op()(fields.triangle_strain)
flow_descend = torch_op()(flow.flow_descend)
flow_left = torch_op()(flow.flow_left)
flow_template = torch_op()(flow.flow_template)
find_pairs = torch_op()(tracking.find_pairs)
find_templates = torch_op()(tracking.find_templates)
halve = torch_op()(tracking.halve)
mean_response = torch_op()(tracking.mean_response)
prepare_templates = torch_op()(tracking.prepare_templates)
sample_windows = torch_op()(tracking.sample_windows)
search_windows = torch_op()(tracking.search_windows)
spline_coefficients = torch_op()(tracking.spline_coefficients)
