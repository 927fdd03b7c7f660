"""A bundle's graphs by compiled kernels: what they ask for, when they refuse. tests/test_one_graph.py plays them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fingerflow import kernels
from fingerflow.errors import FingerflowError
from fingerflow.export.build import build
from fingerflow.export.bundle import version
from fingerflow.export.compiled import CompiledGraphs
from fingerflow.export.recipe import Recipe, load_recipe
from fingerflow.graphs.frame import COMPILED_DO_WITHOUT
from tests.small_trials import POINTS, beside

RECIPE = """
[views]
height = 64
width = 80
[tracking]
points = 20
window_px = 11
"""

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="no compiled kernels here")


@pytest.fixture(scope="module")
def recipe(tmp_path_factory: pytest.TempPathFactory) -> Recipe:
    file = tmp_path_factory.mktemp("recipe") / "recipe.toml"
    file.write_text(RECIPE)
    return load_recipe(file)


def test_a_graph_asks_for_what_its_file_asks_for_but_for_what_kernels_do_without(bundle_of_trials: Path) -> None:
    recipe = load_recipe(beside(bundle_of_trials)[0])
    session = CompiledGraphs(recipe.model_dump(), version()).open("fields", bundle_of_trials / "fields.onnx")
    assert session.get_modelmeta().custom_metadata_map["fingerflow.graph"] == "fields"
    inputs = {one.name: one.shape for one in session.get_inputs()}
    assert inputs["points"] == [1, POINTS, 2]
    feed: dict[str, Any] = {name: np.ones(shape, np.float32) for name, shape in inputs.items()}
    feed |= {name: np.ones((1, POINTS), np.uint8) for name in ("covered", "reached", "entry")}
    reached, divergence = session.run(["next_reached", "divergence"], feed)
    assert (reached == 2).all()  # one more frame than before
    assert np.isnan(divergence).all()  # all points in one place


def test_templates_are_held_without_what_the_portable_form_needs(recipe: Recipe) -> None:
    graphs = build(recipe, without=COMPILED_DO_WITHOUT)
    for name in COMPILED_DO_WITHOUT:
        assert name in build(recipe)["key"].outputs
        assert name not in graphs["key"].outputs
        assert name not in graphs["frame"].inputs
        assert name not in graphs["renew"].outputs


@pytest.mark.parametrize(
    ("changed", "made_by", "said"),
    [
        ({}, "0.0.1", "written by fingerflow 0.0.1"),
        ({"export": {"precision": "float64"}}, None, "computes in float64"),
        ({"views": {"height": 0, "width": 80}}, None, "recipe of bundle.json"),
    ],
)
def test_other_bundles_are_refused(recipe: Recipe, changed: dict[str, Any], made_by: str | None, said: str) -> None:
    with pytest.raises(FingerflowError, match=said):
        CompiledGraphs(recipe.model_dump() | changed, made_by or version())


def test_an_installation_without_kernels_is_refused(recipe: Recipe, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels, "serve", lambda *_: False)
    with pytest.raises(FingerflowError, match="without its compiled kernels"):
        CompiledGraphs(recipe.model_dump(), version())
