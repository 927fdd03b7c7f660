"""Compiled kernels as torch ops; `serve` checks whether they can be used in place of other ops.

They take plain tensors on the CPU, outside tracing, export and autograd. Their results equal those of the portable op
bit for bit, or to rounding where a docstring says so. While torch compiles they are registered ops,
`torch.ops.fingerflow.<name>`. `FINGERFLOW_KERNELS=0` in the environment turns them off. If they were not built, for
lack of a C++ compiler at install time, the portable ops are used and a log message of level INFO reports it once.
"""

from collections.abc import Iterable

import torch

from fingerflow.kernels import contact, declarations, fields, flow, tracking
from fingerflow.kernels.library import inject_fault as inject_fault
from fingerflow.kernels.library import limit_instruction_set as limit_instruction_set
from fingerflow.kernels.tensors.serving import constant_to_compiler as constant_to_compiler
from fingerflow.kernels.tensors.serving import serve as serve
from fingerflow.kernels.tensors.torch_op import torch_op
from fingerflow.kernels.tensors.twins import Twin as Twin
from fingerflow.kernels.tensors.twins import twin as twin


def _dtypes(kinds: Iterable[str]) -> tuple[torch.dtype, ...]:
    return tuple(getattr(torch, kind) for kind in kinds)


FRAME_KINDS = _dtypes(declarations.FRAME_KINDS)
COUNTED_DTYPES = _dtypes(contact.COUNTED_LEVELS)
histogram = torch_op()(contact.histogram)
median = torch_op()(contact.median)
correct_points = torch_op()(tracking.correct_points)
area_medians = torch_op()(fields.area_medians)
local_gradients = torch_op()(fields.local_gradients)
triangle_strain = torch_op()(fields.triangle_strain)
flow_descend = torch_op()(flow.flow_descend)
find_templates = torch_op()(tracking.find_templates)
