"""Test of the shipped recipes: each is exported, and its bundle is played as a separate process."""

from pathlib import Path

import numpy as np
import pytest

from bench.streams import exported, play
from fingerflow.results.stream_result import open_stream

RECIPES = Path(__file__).parents[2] / "export"
FRAMES = 260  # two presses of the synthetic source


@pytest.mark.long
@pytest.mark.parametrize("name", ["exact", "fast"])
def test_a_shipped_recipe_measures_the_median_divergence_of_nearly_all_frames(name: str, tmp_path: Path) -> None:
    with exported((RECIPES / f"{name}.toml").read_text(encoding="utf-8")) as bundle:
        summary = play(bundle, frames=FRAMES, results=tmp_path / "results")
    assert summary["processed"] == FRAMES
    assert not summary["dropped"]
    # Points are seeded in the contact after a few frames, which have no median.
    median = open_stream(tmp_path / "results")["median_divergence"].to_numpy()
    assert np.isnan(median).mean() < 0.04
