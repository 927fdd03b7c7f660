"""Test that wrong calls of every function of kernels end in an exception with a message or in a right result, never in
a crash.
"""

import sys

import pytest
import torch

from fingerflow.kernels import tensors as kernels
from tests.kernels import hostile_calls

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off"),
    pytest.mark.skipif(sys.platform != "linux", reason="forks and pages that cannot be read are Linux's"),
    pytest.mark.filterwarnings("ignore"),  # forks with threads, casts that overflow
]


def test_hostile_calls(torch_threads: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "get_num_threads", lambda: 1)  # a forked child has no pool
    plain = hostile_calls.plain_calls()
    assert not hostile_calls.missing_entries(plain), "give kernel_calls.py a call that reaches these entries"
    count, wrong = 0, []
    for name, call in plain.items():
        for hostile, word, said in hostile_calls.outcomes(list(hostile_calls.hostile_calls({name: call})), call):
            count += 1
            if word not in (hostile_calls.REFUSED, hostile_calls.GIVEN):
                wrong.append(f"{name}, {hostile.argument} {hostile.change}: {word}, {said}")
    assert not wrong, "\n".join(wrong)
    assert count > 4000
