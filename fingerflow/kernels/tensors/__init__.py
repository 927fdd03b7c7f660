"""The compiled twins of some ops: whether they serve, and one op of torch's for each function of kernels.

They serve plain tensors on the processor, outside tracing, export and autograd, and give what the portable op gives,
bit for bit, or to rounding where a docstring says so. While torch compiles they are ops of its own.
`FINGERFLOW_KERNELS=0` in the environment turns them off. Where they were not built, because no C++ compiler was there
at install time, the portable ops serve and a log message of level INFO says so once.
"""

from fingerflow.kernels.library import inject_fault as inject_fault
from fingerflow.kernels.library import limit_instruction_set as limit_instruction_set
from fingerflow.kernels.tensors.serving import constant_to_compiler as constant_to_compiler
from fingerflow.kernels.tensors.serving import serve as serve
from fingerflow.kernels.tensors.typed import *  # noqa: F403  what its `__all__` names is offered here
