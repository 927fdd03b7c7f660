"""What trials of one process take of its processor, on a clock that a test sets."""

from threading import Lock
from types import SimpleNamespace

import pytest

from fingerflow.study import processor
from fingerflow.study.processor import Share


class FreshShare(Share):
    """`Share` in a process that has run no trial: it adds to sums of its class, which trials of other tests leave."""

    _lock, _running, _each, _looked = Lock(), 0, 0.0, 0.0


def test_shares_are_of_those_that_run_and_all_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """A long trial beside a short one has the processor for itself afterwards.

    All seconds and their halves are whole numbers, so that sums from zero on are exact.
    """
    clock = SimpleNamespace(now=5.0)
    monkeypatch.setattr(processor, "time", SimpleNamespace(process_time=lambda: clock.now))
    with FreshShare() as long:
        clock.now = 6.0
        with FreshShare() as short:
            clock.now = 10.0
            assert short.seconds() == 2.0
        clock.now = 20.0
        assert long.seconds() == 13.0
    clock.now = 100.0
    with FreshShare() as later:
        assert later.seconds() == 0.0
