"""Test of the closed loop of the benchmark: a camera with time stamps of its own, a trigger in two ways. Times are not
tested.
"""

import sys
from pathlib import Path

import pytest

from bench.rows import number
from bench.suites import closed_loop
from fingerflow.export.carried_modules import carry_modules
from fingerflow.kernels.library import is_present
from fingerflow.schema.recipe import load_recipe
from tests.small_trials import write_library_bundle

pytestmark = pytest.mark.long


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")
def test_no_trigger_is_lost(tmp_path: Path) -> None:
    if not is_present():
        pytest.skip("the compiled library was not built or is turned off: graphs of this bundle are none")
    bundle = write_library_bundle(tmp_path / "bundle", load_recipe(closed_loop.RECIPE))
    carry_modules(bundle)
    results, *ways = closed_loop.measure(tmp_path, bundle, 600)
    assert (results["received"], [way["way"] for way in ways]) == (600, ["UDP", "serial line"])
    for way in ways:
        # Each period of 238 frames has one rise: in frames 0 to 118, and in those from 238 and from 476 on.
        assert number(way, "expected") == number(way, "received") == 3
        assert 0 < number(way, "p50_ms") <= number(way, "worst_ms")
