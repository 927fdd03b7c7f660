"""Every kernel with the inputs of the tests of twins, by a library that was compiled with a sanitizer.

Run as `python -m tests.kernels.sanitized_calls LIBRARY all` with the sanitizer loaded first (LD_PRELOAD): then memory
of NumPy and torch ends where their arrays do. With `last` only the call of each twin with work for several threads.
Then every kernel with an error in its last piece, of each sort, on whichever thread.
"""

import sys
from contextlib import suppress
from pathlib import Path

import torch

from fingerflow.kernels import library
from fingerflow.kernels.library import declared

if __name__ == "__main__":
    library._path = lambda: Path(sys.argv[1])
    assert library.is_present()
    from fingerflow.kernels import tensors as kernels
    from tests.kernels.kernel_calls import calls, reached
    from tests.kernels.test_kernel_faults import ERROR, NO_MEMORY, UNKNOWN
    from tests.kernels.twins import TWINS

    torch.set_num_threads(3)
    entered: set[str] = set()
    for twin in TWINS.values():
        for op, given in list(twin.calls())[0 if sys.argv[2] == "all" else -1 :]:
            entered |= reached(lambda op=op, given=given: op(*given)).keys()
    for call in calls().values():
        entered |= reached(call).keys()
    for call in calls().values():
        for fault in (NO_MEMORY, ERROR, UNKNOWN):
            kernels.inject_fault(fault, -1)
            with suppress(MemoryError, RuntimeError):
                call()
        kernels.inject_fault(0)
    print("not entered:", sorted(declared().keys() - entered - {"inject_fault", "limit_instruction_set"}))
