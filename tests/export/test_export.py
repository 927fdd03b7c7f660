"""Export to ONNX: a small bundle that holds what it promises, and refusals that leave nothing behind."""

import hashlib
import json
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from torch import Tensor

from fingerflow import player
from fingerflow.errors import FingerflowError
from fingerflow.export import Difference, export_bundle, verify
from fingerflow.export.build import build
from fingerflow.export.portable import Portable
from fingerflow.export.recipe import GRAPHS, load_recipe
from fingerflow.export.trial import cases, feed
from fingerflow.player.motion import Motion
from fingerflow.player.scene import load_scene
from fingerflow.player.sources.synthetic import Synthetic
from fingerflow.player.stepper import LAG
from tests.small_trials import HEIGHT, POINTS, WIDTH, beside

RECIPE = """
[views]
height = 96
width = 120
bit_depth = {bits}
batch = {batch}
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


def _recipe(
    folder: Path, bits: int = 8, batch: str = "1", tracking: str = "", contact: str = "", graphs: str = ""
) -> Path:
    path = folder / "recipe.toml"
    names = graphs or ", ".join(f'"{name}"' for name in GRAPHS)
    path.write_text(RECIPE.format(bits=bits, batch=batch, tracking=tracking, contact=contact, graphs=names))
    return path


def test_bundle_holds_graphs_player_and_what_to_do(bundle_of_trials: Path) -> None:
    folder = bundle_of_trials
    about = json.loads((folder / "bundle.json").read_text())
    assert list(about["graphs"]) == list(GRAPHS)
    for entry in about["graphs"].values():
        assert hashlib.sha256((folder / entry["file"]).read_bytes()).hexdigest() == entry["sha256"]
    for name in ("player/__main__.py", "player/page/index.html", "README.md", "requirements.txt", "scene.toml"):
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


def test_verification_covers_every_output(bundle_of_trials: Path) -> None:
    recipe, verification = beside(bundle_of_trials)
    rows = [Difference(**one) for one in json.loads(verification.read_text(encoding="utf-8"))]
    graphs = build(load_recipe(recipe))
    expected = {(name, output) for name, graph in graphs.items() for output in graph.outputs}
    assert {(row.graph, row.output) for row in rows} == expected
    points = {row.graph: row for row in rows if row.output == "points"}
    assert points["track"].to_float64 <= 1e-3
    assert points["frame"].to_float64 <= 1e-3
    assert all(row.to_torch == 0 for row in rows if row.output in ("real_contact_mask", "status", "covered"))


def test_state_goes_round(bundle_of_trials: Path) -> None:
    """Two frames of a stream by ONNX Runtime alone: what a frame gives as next_X is the next one's X."""
    recipe = load_recipe(beside(bundle_of_trials)[0])
    case = cases(recipe, 1)[0].inputs
    names = ("background", "key", "frame", "fields")
    sessions = {name: onnxruntime.InferenceSession(bundle_of_trials / f"{name}.onnx") for name in names}
    known = {name: tensor.numpy() for name, tensor in case.items()}
    known["reference"] = np.full_like(known["points"], np.nan)
    known["reached"] = known["entry"] = np.zeros(known["points"].shape[:2], np.uint8)

    def run(name: str) -> dict[str, np.ndarray]:
        session = sessions[name]
        outputs = [one.name for one in session.get_outputs()]
        source = {**known, "topography_view": known["key_view"]} if name == "key" else known
        inputs = {one.name: source[one.name] for one in session.get_inputs()}
        return dict(zip(outputs, session.run(outputs, inputs), strict=True))

    known |= run("background")
    known |= run("key")
    known |= (frame := run("frame"))
    tracked, covered = frame["status"] == 0, frame["covered"] == 1
    assert tracked.sum() >= 10
    first = run("fields")
    arrived = np.isfinite(first["next_reference"]).all(-1)
    np.testing.assert_array_equal(arrived, tracked & covered)
    assert 0 < arrived.sum() < tracked.sum()
    np.testing.assert_array_equal(first["next_reached"], frame["covered"])
    # A point moves, one is lost, the others arrive; what was lost at its arrival has no onset.
    known |= {name.removeprefix("next_"): value for name, value in first.items() if name.startswith("next_")}
    here = np.flatnonzero(arrived[0])
    known["points"] = np.where(arrived[..., None], frame["points"] * 1.01, frame["points"])
    known["points"][0, here[0]] = np.nan
    known["covered"] = np.ones_like(frame["covered"])
    second = run("fields")
    np.testing.assert_array_equal(second["next_reference"][arrived], first["next_reference"][arrived])
    np.testing.assert_array_equal(np.isfinite(second["next_reference"]).all(-1), arrived | (tracked & ~covered))
    assert np.isnan(second["divergence"][0, here[0]])
    known |= {name.removeprefix("next_"): value for name, value in second.items() if name.startswith("next_")}
    known["points"] = np.where(np.isnan(frame["points"]), 40.0, frame["points"]).astype(np.float32)
    np.testing.assert_array_equal(run("fields")["next_reference"], second["next_reference"])


SCENE = f"""
[views]
contact = {{rows = [0, {HEIGHT}], columns = [{WIDTH}, {2 * WIDTH}]}}
topography = {{rows = [0, {HEIGHT}], columns = [0, {WIDTH}]}}
[calibration]
mm_per_px = 0.05
topography_to_contact = [[0.999, 0.002, 0.4], [-0.002, 0.999, -0.3]]
[stream]
rekey_frames = 12
"""


def test_the_player_gives_what_torch_gives(bundle_of_trials: Path, tmp_path: Path) -> None:
    """Every frame of a synthetic stream, with threshold and key frames, and torch's own states fed back to torch."""
    scene_file = tmp_path / "scene.toml"
    scene_file.write_text(SCENE)
    options = ["--source", "synthetic", "--scene", str(scene_file), "--frames", "40", "--output", str(tmp_path / "out")]
    settings = ["--page", "off", "--provider", "cpu", "--threads", "1", "--no-spin"]
    assert player.main([str(bundle_of_trials), *options, *settings]) == 0
    records, _, events = player.read_results(tmp_path / "out")
    assert len(records) == 40
    keyed = {event["frame"] for event in events if event["event"] == "key_frame"}
    chosen = {event["frame"] for event in events if event["event"] == "restart"}
    assert min(keyed) <= 12
    assert 0 in chosen

    scene = load_scene(scene_file)
    drawn = Synthetic(scene, np.dtype(np.uint8), 8)
    graphs = build(load_recipe(beside(bundle_of_trials)[0]))

    def tensor(picture: np.ndarray) -> Tensor:
        return torch.from_numpy(picture[None, None].copy())

    known: dict[str, Tensor] = {
        "background": tensor(scene.contact.crop(drawn.background)).float(),
        "threshold": torch.full((1,), torch.nan),
        "mask": torch.ones(1, 1, HEIGHT, WIDTH, dtype=torch.bool),
        "topography_to_contact": torch.tensor(scene.topography_to_contact, dtype=torch.float32),
        "mm_per_px": torch.tensor([scene.mm_per_px]),
    }
    known["dark"] = torch.zeros_like(known["background"])

    def run(name: str) -> dict[str, Tensor]:
        graph = graphs[name]  # type: ignore[index]
        with torch.inference_mode(), Portable():
            return dict(zip(graph.outputs, graph.module(*(known[one] for one in graph.inputs)), strict=True))

    def key(view: Tensor, points: Tensor) -> None:
        now = known["topography_view"]
        known.update({"topography_view": view, "points": points, "warp": torch.eye(2).expand(1, POINTS, 2, 2)})
        known.update(run("key"))
        known["topography_view"] = now

    def choose(view: Tensor, number: int) -> list[Motion]:
        known["topography_view"] = view
        points = run("detect")["points"]
        known["reference"] = torch.full_like(points, torch.nan)
        known["reached"] = known["entry"] = torch.zeros(points.shape[:2], dtype=torch.uint8)
        known["at_entry"], known["chosen"] = torch.full((*points.shape, 2), torch.nan), points
        key(view, points)
        return [Motion.at_rest(points.numpy(), number)] * LAG

    measured, views, tracks = [], [], []
    motions: list[Motion] = []  # after each of the last frames
    for number, record in enumerate(records):
        picture = drawn.read()
        views.append(tensor(scene.topography.crop(picture)))
        known["contact_view"] = tensor(scene.contact.crop(picture))
        changed = number - LAG  # what was decided there counts now
        if number == 0:
            known |= run("background")
            motions = choose(views[0], 0)
        if changed in keyed:
            motions = [motion.without(tracks[changed].numpy()) for motion in motions]
            key(views[changed], tracks[changed])
        if changed > 0 and changed in chosen:
            motions = choose(views[changed], changed)
        if measured and measured[-1][0] == changed:
            known["threshold"] = measured[-1][1]
            known |= run("background")
        known["topography_view"] = views[number]
        known["prediction"] = torch.from_numpy(motions[0].expect(number))
        if any(event["frame"] == number for event in events if event["event"] == "threshold"):
            measured.append((number, run("contact")["threshold"]))
        results = run("frame")
        known |= results
        results |= run("fields")
        known |= {name.removeprefix("next_"): value for name, value in results.items() if name.startswith("next_")}
        tracks.append(results["points"])
        motions = [*motions[1:], motions[-1].see(results["points"].numpy(), number, results["by_neighbours"].numpy())]
        np.testing.assert_array_equal(record["status"], results["status"][0])
        np.testing.assert_allclose(record["position_px"], results["points"][0], rtol=0, atol=1e-3)
        for name in ("real", "gross"):
            np.testing.assert_allclose(
                record[f"{name}_contact_area"], results[f"{name}_area_px"][0] * 0.05**2, rtol=1e-5
            )
        for name in ("divergence", "median_divergence"):
            np.testing.assert_allclose(record[name], results[name][0], rtol=0, atol=2e-4)
    found = [(event["frame"], event["threshold"]) for event in events if event["event"] == "threshold"]
    assert found == [(number, pytest.approx(threshold.item(), abs=1e-4)) for number, threshold in measured]
    assert np.isfinite(records["position_px"]).all(-1).sum(1).min() >= 10
    assert records["real_contact_area"][-1] > records["real_contact_area"][LAG] > records["real_contact_area"][0] == 0
    assert np.isfinite(records["divergence"][-1]).any()  # 24 points do not fill the contact: no median over it


@pytest.mark.parametrize(
    ("settings", "graphs"),
    [
        ({"bits": 12}, '"contact"'),
        (
            {
                "bits": 12,
                "batch": '"dynamic"',
                "contact": "median_px = 9\nstride_px = 8",
                "tracking": "gain_offset = false",
            },
            '"frame"',
        ),
    ],
    ids=["12 bit", "12 bit, open batch"],
)
def test_other_recipes_export(settings: dict[str, str | int], graphs: str, tmp_path: Path) -> None:
    """`frame` follows points as `track` does."""
    rows = export_bundle(_recipe(tmp_path, graphs=graphs, **settings), tmp_path / "bundle")  # type: ignore[arg-type]
    assert rows


def test_a_graph_that_differs_is_refused(bundle_of_trials: Path) -> None:
    recipe = load_recipe(beside(bundle_of_trials)[0])
    other = recipe.model_copy(update={"fields": recipe.fields.model_copy(update={"gauge_length_mm": 1.4})})
    with pytest.raises(FingerflowError, match="divergence"):
        verify(other, bundle_of_trials)


def test_a_failed_export_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise FingerflowError("no")

    monkeypatch.setattr("fingerflow.export.bundle.verify", fail)
    with pytest.raises(FingerflowError, match="no"):
        export_bundle(_recipe(tmp_path, graphs='"background"'), tmp_path / "bundle")
    assert [path.name for path in tmp_path.iterdir()] == ["recipe.toml"]


def test_an_existing_folder_is_kept(tmp_path: Path) -> None:
    (tmp_path / "bundle").mkdir()
    with pytest.raises(FingerflowError, match="exists already"):
        export_bundle(_recipe(tmp_path), tmp_path / "bundle")


def test_float64_reference_is_another_precision() -> None:
    """The verification compares with numbers that are really computed in float64."""
    recipe = load_recipe(Path(__file__).parents[2] / "export" / "fast.toml")
    fields = build(recipe, torch.float64)["fields"]
    case = cases(recipe, 1)[0].inputs
    given = (one.double() if one.is_floating_point() else one for one in feed("fields", fields, case))
    results = fields.module(*given)
    assert {one.dtype for one in results if one.is_floating_point()} == {torch.float64}
