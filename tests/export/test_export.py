"""Tests of the export to ONNX: a small bundle is complete, and a refused export leaves nothing behind."""

import hashlib
import json
from pathlib import Path

import numpy as np
import onnx
import pytest

from fingerflow.engines.check import TOLERANCES, built_in
from fingerflow.errors import FingerflowError
from fingerflow.export import as_text, export_bundle
from fingerflow.schema.recipe import GRAPHS
from tests.small_trials import HEIGHT, POINTS, WIDTH, beside

RECIPE = """
[views]
height = 96
width = 120
bit_depth = {bits}
[tracking]
points = 24
window_px = 11
{tracking}
[contact]
{contact}
[fields]
gauge_length_mm = 3.5
[export]
graphs = [{graphs}]
"""


def _recipe(folder: Path, bits: int = 8, tracking: str = "", contact: str = "", graphs: str = "") -> Path:
    path = folder / "recipe.toml"
    names = graphs or ", ".join(f'"{name}"' for name in GRAPHS)
    path.write_text(RECIPE.format(bits=bits, tracking=tracking, contact=contact, graphs=names))
    return path


def test_bundle_holds_graphs_player_and_what_to_do(bundle_of_trials: Path) -> None:
    folder = bundle_of_trials
    about = json.loads((folder / "bundle.json").read_text())
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert set(about["files"]) == files - {"bundle.json", "scene.toml"} >= {f"{name}.onnx" for name in GRAPHS}
    for name, digest in about["files"].items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest
    player = ("fingerflow/player/__main__.py", "fingerflow/player/page/index.html")
    for name in (*player, "README.md", "requirements.txt", "scene.toml"):
        assert (folder / name).stat().st_size > 0
    assert not list(folder.parent.glob(f".{folder.name}-*"))


@pytest.mark.parametrize("name", GRAPHS)
def test_graph_is_standard_and_says_what_it_is(name: str, bundle_of_trials: Path) -> None:
    model = onnx.load(bundle_of_trials / f"{name}.onnx")
    onnx.checker.check_model(model, full_check=True)
    assert {(one.domain, one.version) for one in model.opset_import} == {("", 18)}
    assert not {node.op_type for node in model.graph.node} & {"Loop", "If", "Scan"}
    assert not model.functions
    assert "/" not in "".join(node.doc_string for node in model.graph.node)
    facts = {one.key: one.value for one in model.metadata_props}
    assert facts["fingerflow.graph"] == name
    named = {one.name for one in (*model.graph.input, *model.graph.output)}
    assert named <= set(json.loads(facts["fingerflow.units"]))
    assert {"fingerflow.version", "fingerflow.recipe", "fingerflow.coordinates", "fingerflow.hash"} <= set(facts)


def test_the_verification_is_returned(bundle_of_trials: Path) -> None:
    rows = json.loads(beside(bundle_of_trials)[1].read_text(encoding="utf-8"))
    assert {row["result"] for row in rows} == set(TOLERANCES)
    assert all(row["difference"] <= row["tolerance"] for row in rows)
    assert 0 < next(row["difference"] for row in rows if row["result"] == "corrected") < 1e-3
    assert as_text(rows).count("\n") == len(rows)


def test_the_bundle_states_the_numbers_of_a_built_in_frame(bundle_of_trials: Path) -> None:
    """bundle.json is strict JSON and states the numbers of the built-in frame, in which some points are NaN."""
    expected = json.loads((bundle_of_trials / "bundle.json").read_text(), parse_constant=pytest.fail)["expected"]
    frame = built_in(HEIGHT, WIDTH, 8, POINTS, 21)
    known = np.isfinite(frame.points[:, 0])
    assert 0.8 < known.mean() < 0.9
    numbers = {name: np.array(values, float) for name, values in expected["numbers"].items()}
    # The texture gives the true position of each point; before the correction a template has a bias.
    truth = frame.expected[known] - 0.2
    for name, error in (("found", 0.1), ("corrected", 0.06)):
        np.testing.assert_array_equal(np.isfinite(numbers[name][:, 0]), known)
        assert np.sqrt(np.square(numbers[name][known] - truth).mean()) < error
    assert numbers["gross_area_px"] > numbers["real_area_px"] > 1000


@pytest.mark.long
def test_other_recipes_export(tmp_path: Path) -> None:
    """Graphs of other settings are verified, also where only some are exported."""
    settings = {"contact": "median_px = 5\nstride_px = 8", "tracking": "gain_offset = false"}
    graphs = '"contact", "prepare", "track", "search"'
    assert export_bundle(_recipe(tmp_path, bits=12, graphs=graphs, **settings), tmp_path / "bundle")


@pytest.mark.long
def test_a_failed_export_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise FingerflowError("no")

    monkeypatch.setattr("fingerflow.export.write_bundle.verify", fail)
    with pytest.raises(FingerflowError, match="no"):
        export_bundle(_recipe(tmp_path, graphs='"noise"'), tmp_path / "bundle")
    assert [path.name for path in tmp_path.iterdir()] == ["recipe.toml"]


def test_an_existing_folder_is_kept(tmp_path: Path) -> None:
    (tmp_path / "bundle").mkdir()
    with pytest.raises(FingerflowError, match="exists already"):
        export_bundle(_recipe(tmp_path), tmp_path / "bundle")
