"""Test of the shipped recipes, played by the compiled library."""

from pathlib import Path

import numpy as np
import pytest

from fingerflow import player
from fingerflow.kernels.library import is_present
from fingerflow.schema.recipe import load_recipe
from tests.small_trials import write_library_bundle

RECIPES = Path(__file__).parents[2] / "export"
FRAMES = 260  # two presses of the synthetic source


@pytest.mark.long
@pytest.mark.skipif(not is_present(), reason="the compiled library was not built or is turned off")
@pytest.mark.parametrize("name", ["exact", "fast"])
def test_a_shipped_recipe_measures_the_median_divergence_of_nearly_all_frames(name: str, tmp_path: Path) -> None:
    bundle = write_library_bundle(tmp_path / "bundle", load_recipe(RECIPES / f"{name}.toml"))
    summary = player.play(bundle, "synthetic", frames=FRAMES, output=tmp_path / "out", page="off")
    assert "rim" not in str(summary["warnings"])
    # Points are seeded in the contact after a few frames, which have no median.
    median = player.read_results(tmp_path / "out").records["median_divergence"]
    assert len(median) == FRAMES
    assert np.isnan(median).mean() < 0.04
