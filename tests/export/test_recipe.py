"""Tests of recipes: the shipped ones are valid, and errors of others are named."""

from pathlib import Path

import pytest

from fingerflow.errors import FingerflowError
from fingerflow.schema.recipe import GRAPHS, load_recipe

RECIPES = sorted((Path(__file__).parents[2] / "export").glob("*.toml"))


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.stem)
def test_shipped_recipes_are_valid(path: Path) -> None:
    assert load_recipe(path).views.height > 0


def test_a_bundle_has_by_default_what_the_engine_opens(tmp_path: Path) -> None:
    """By default a bundle has the graphs that the engine opens and no others, because each graph is exported, verified
    and carried to the lab.
    """
    (tmp_path / "recipe.toml").write_text("[views]\nheight = 512\nwidth = 640\n")
    assert {*load_recipe(tmp_path / "recipe.toml").export.graphs} == {*GRAPHS}


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "views"),
        ("[views\n", "is not valid TOML"),
        ("[views]\nheight = 512\nwidth = 640\nbit_depth = 20\n", "views.bit_depth"),
        ("[views]\nheight = 512\nwidth = 640\n[tracking]\nwindow_px = 20\n", "20 is even"),
        ("[views]\nheight = 512\nwidth = 640\n[tracking]\npoint = 20\n", "tracking.point"),
        ("[views]\nheight = 48\nwidth = 48\n[tracking]\npoints = 500\n", "no more than 144"),
    ],
)
def test_wrong_recipes_are_named(text: str, named: str, tmp_path: Path) -> None:
    path = tmp_path / "recipe.toml"
    path.write_text(text)
    with pytest.raises(FingerflowError, match=named) as error:
        load_recipe(path)
    assert str(path) in str(error.value)


def test_a_missing_recipe_is_named(tmp_path: Path) -> None:
    with pytest.raises(FingerflowError, match=r"absent\.toml: there is no such file.*recipes are TOML"):
        load_recipe(tmp_path / "absent.toml")
