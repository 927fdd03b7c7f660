"""What trials of one process take of its processor, on a clock that a test sets."""

from types import SimpleNamespace

import pytest

from fingerflow.study import processor
from fingerflow.study.processor import Share


def test_shares_are_of_those_that_run_and_all_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """A long trial beside a short one has the processor for itself afterwards."""
    clock = SimpleNamespace(now=5.0)
    monkeypatch.setattr(processor, "time", SimpleNamespace(process_time=lambda: clock.now))
    with Share() as long:
        clock.now = 6.0
        with Share() as short:
            clock.now = 10.0
            assert short.seconds() == 2.0
        clock.now = 20.0
        assert long.seconds() == 13.0
    clock.now = 100.0
    with Share() as later:
        assert later.seconds() == 0.0
