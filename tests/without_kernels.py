"""Portable ops in place of the compiled kernels, for tests that compare both."""

import pytest

from fingerflow.kernels import tensors as kernels


def without_kernels(patch: pytest.MonkeyPatch) -> None:
    """Let the portable ops serve: neither `kernels.serve` nor a twin accepts any tensor."""
    patch.setattr(kernels, "serve", lambda *tensors: False)
    patch.setattr("fingerflow.kernels.tensors.twins.serve", lambda *tensors: False)
