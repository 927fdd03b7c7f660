"""Compiled counterparts of some ops: whether they can be used, and one torch op for each function of kernels.

They take plain tensors on the CPU, outside tracing, export and autograd. Their results equal those of the portable op
bit for bit, or to rounding where a docstring says so. While torch compiles they are registered ops.
`FINGERFLOW_KERNELS=0` in the environment turns them off. If they were not built, for lack of a C++ compiler at install
time, the portable ops are used and a log message of level INFO reports it once.
"""

from fingerflow.kernels.library import inject_fault as inject_fault
from fingerflow.kernels.library import limit_instruction_set as limit_instruction_set
from fingerflow.kernels.tensors.serving import constant_to_compiler as constant_to_compiler
from fingerflow.kernels.tensors.serving import serve as serve
from fingerflow.kernels.tensors.typed import *  # noqa: F403  exports the names of its `__all__`
