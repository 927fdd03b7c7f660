"""Tests of the reuse of an earlier result: equal to a fresh run bit for bit, without unnecessary computation."""

import json
import shutil
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from typer.testing import CliRunner

import fingerflow
from fingerflow import load_scene, process
from fingerflow.cli import app
from fingerflow.errors import FingerflowError
from fingerflow.pipeline.plan import OUTPUTS, VARIABLES, plan
from fingerflow.pipeline.stages import all_stages
from fingerflow.pipeline.stages.preparation.inputs import Inputs
from fingerflow.pipeline.stages.stage import RunContext, Stage
from fingerflow.schema.scene import Scene
from fingerflow.schema.variables import SLIP, by_name
from fingerflow.synthetic import PartialSlip, write_recording
from tests.small_trials import SMALL_SLIP, TINY_PRESS, edit_scene
from tests.test_architecture import ARROWS

PICTURES = {"frame_check", "contact", "tracking"}
#: Change of the scene of a press (old text, new text), and the stages to compute again for all outputs.
CHANGES: dict[str, tuple[str, str, set[str]]] = {
    "gauge length": ("gauge_length_mm = 1.6", "gauge_length_mm = 1.1", {"deformation", "strain"}),
    "stiffness": ("young_modulus_mpa = 1.0", "young_modulus_mpa = 0.5", {"deformation", "strain"}),
    "threshold": ('threshold = "reference_frame"', "threshold = 0.3", {"contact", "tracking", "deformation", "strain"}),
    "slip, which nothing asks for": ("# [slip]", "# changed [slip]", set()),
}


@pytest.fixture(scope="module")
def folder(tiny_press: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("reuse") / "press"
    shutil.copytree(tiny_press, path)
    text = (path / "scene.toml").read_text(encoding="utf-8")
    (path / "scene.toml").write_text('kind = "press"\n' + text, encoding="utf-8")
    process(path / "scene.toml", to=path / "result.h5").close()
    return path


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Return a set that collects the names of the stages that have begun."""
    found: set[str] = set()
    for stage in _every_stage():
        monkeypatch.setattr(stage, "begin", _noting(stage.begin, found))
    return found


def _every_stage() -> set[type[Stage]]:
    """Return all stage classes, including the variants that a setting selects."""
    return {one for stage in all_stages() for one in (stage, *stage.__subclasses__())}


def _noting(begin: Callable[[Stage], None], found: set[str]) -> Callable[[Stage], None]:
    def begun(stage: Stage) -> None:
        found.add(stage.name)
        begin(stage)

    return begun


def assert_same(found: xr.Dataset, expected: xr.Dataset) -> None:
    """Check that two results are equal bit for bit, with units, definitions and warnings."""
    assert set(found.data_vars) == set(expected.data_vars)
    for name in map(str, expected.variables):
        one, other = found[name], expected[name]
        assert one.dims == other.dims, name
        assert one.dtype == other.dtype, name
        assert one.values.tobytes() == other.values.tobytes(), name
        assert {key: np.asarray(value).tolist() for key, value in one.attrs.items()} == {
            key: np.asarray(value).tolist() for key, value in other.attrs.items()
        }, name
    assert json.loads(found.attrs["warnings"]) == json.loads(expected.attrs["warnings"])
    keys = [
        {name: one["digest"] for name, one in json.loads(each.attrs["stages"]).items()} for each in (found, expected)
    ]
    assert keys[0] == keys[1]


@pytest.mark.parametrize("change", CHANGES)
def test_each_setting_gives_what_a_fresh_run_gives(folder: Path, change: str, ran: set[str]) -> None:
    old, new, touched = CHANGES[change]
    scene = load_scene(edit_scene(folder, {old: new}, "changed.toml"))
    fresh = process(scene)
    everything = set(ran)
    ran.clear()
    again = process(scene, earlier=folder / "result.h5")
    assert ran == touched
    taken = json.loads(again.attrs["taken_over"])
    assert set(taken["stages"]) == everything - touched
    assert set(taken["computed"]) == touched
    assert_same(again, fresh)


def test_outputs_that_were_not_there_are_computed(folder: Path, ran: set[str]) -> None:
    scene = load_scene(folder / "scene.toml")
    again = process(scene, ["shear"], earlier=folder / "result.h5")
    assert ran == {"deformation"}
    assert json.loads(again.attrs["taken_over"])["computed"]["deformation"] == "shear is not there"
    assert_same(again, process(scene, ["shear_std"]))
    ran.clear()
    process(scene, ["gross_contact_region"], earlier=folder / "result.h5")
    assert ran == {"contact"}
    ran.clear()
    area = process(scene, ["real_contact_area"], earlier=folder / "result.h5")
    assert not ran
    assert "position" not in area


def test_a_file_with_other_content_is_a_change(folder: Path, tmp_path: Path, ran: set[str]) -> None:
    """A file with other content under the same name counts as a change."""
    shutil.copytree(folder, tmp_path / "press")
    forces = tmp_path / "press" / "forces.csv"
    forces.write_text(forces.read_text(encoding="utf-8").strip().rpartition("\n")[0], encoding="utf-8")
    process(tmp_path / "press" / "scene.toml", ["normal_force", "strain"], earlier=tmp_path / "press" / "result.h5")
    assert {"loading", "contact"} <= ran  # the reference frame of the contact is the one with the largest force
    np.save(tmp_path / "press" / "frames.npy", np.load(folder / "frames.npy")[[*range(7), 6]])
    ran.clear()
    process(tmp_path / "press" / "scene.toml", earlier=tmp_path / "press" / "result.h5")
    assert {"contact", "tracking"} <= ran  # although the first frame is the same


def test_another_recording_is_refused(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    write_recording(other, replace(TINY_PRESS, n_frames=7))
    with pytest.raises(FingerflowError, match=r"(?s)result\.h5 is of another recording than .*frames\.npy.*--from"):
        process(other / "scene.toml", earlier=folder / "result.h5")


def test_results_of_other_code_are_computed_again(
    folder: Path, tmp_path: Path, ran: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Results of another version, or that do not state the code they come from, are computed again."""
    with xr.open_dataset(folder / "result.h5", engine="h5netcdf") as stored:
        old = stored.load()
    del old.attrs["stages"]
    old.to_netcdf(tmp_path / "old.h5", engine="h5netcdf")
    again = process(folder / "scene.toml", ["real_contact_area"], earlier=tmp_path / "old.h5")
    assert ran == {"loading", "frame_check", "contact"}
    assert "older version" in json.loads(again.attrs["taken_over"])["computed"]["contact"]
    ran.clear()
    monkeypatch.setattr(fingerflow.pipeline.reuse, "code_version", lambda: "another")
    again = process(folder / "scene.toml", ["real_contact_area"], earlier=folder / "result.h5")
    assert ran == {"loading", "frame_check", "contact"}
    assert "another version" in json.loads(again.attrs["taken_over"])["computed"]["frame_check"]


def test_results_of_another_engine_are_computed_again(
    folder: Path, tmp_path: Path, ran: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Results of another engine agree only to rounding and are computed again, as reuse is bit for bit."""
    scene, wanted = load_scene(folder / "scene.toml"), ["real_contact_area"]
    path = tmp_path / "torch.h5"
    assert process(scene, wanted, engine="torch", to=path).attrs["engine"] == "torch"
    ran.clear()
    default = process(scene, wanted, earlier=path)
    assert ran == ({"loading", "frame_check", "contact"} if default.attrs["engine"] == "native" else set())
    if ran:
        assert "by another engine" in json.loads(default.attrs["taken_over"])["computed"]["loading"]
    ran.clear()
    assert process(scene, wanted, earlier=path, engine="torch").attrs["engine"] == "torch"
    assert not ran


def test_keys_know_all_code_that_stages_run() -> None:
    """Cache keys cover all packages that `stages` may import, directly or indirectly, except messages of errors."""
    reached, known = set[str](), {*fingerflow.pipeline.reuse._CODE, "stages"}
    left = ["stages"]
    while left:
        for room in ARROWS[left.pop()] - reached - {"__init__"}:  # the version
            reached.add(room)
            left.append(room)
    parts_of = {"tensors": "kernels", "torch_engine": "engines", "choice": "engines", "recorded": "tracker"}
    assert {parts_of.get(room, room) for room in reached} - known == {"errors"}


@pytest.mark.long
def test_the_command_says_what_it_took_over(folder: Path, tmp_path: Path, ran: set[str]) -> None:
    """The command prints which results are reused. Without a scene the command uses the scene of the result, which may
    be replaced.
    """
    shutil.copytree(folder, tmp_path / "press")
    result, scene = tmp_path / "press" / "result.h5", tmp_path / "press" / "scene.toml"
    found = CliRunner().invoke(app, ["process", str(scene), "--from", str(result)])
    assert found.exit_code == 0, found.exception
    assert "deformation" in found.stdout
    assert not ran & PICTURES
    edit_scene(scene.parent, {"depth_mm = 2.0": "depth_mm = 3.0"})
    found = CliRunner().invoke(app, ["process", "--from", str(result)])  # the result now names the copied scene
    assert "computed: strain, since fields.depth_mm was 2.0 and is 3.0" in found.stdout
    assert "taken from" in found.stdout
    with xr.open_dataset(result, engine="h5netcdf") as stored:
        assert_same(stored.load(), process(scene))  # from a result that was itself reused, and replaced in its file
    assert "name a scene file" in str(CliRunner().invoke(app, ["process"]).exception)


# Settings that stages declare, against settings that they read.

_at = threading.local()


class Watched:
    """Proxy of a part of a scene that records which keys the current stage reads."""

    def __init__(self, part: Any, place: str, seen: dict[str, set[str]]) -> None:
        self._watched = (part, place, seen)

    def __getattr__(self, name: str) -> Any:
        part, place, seen = self._watched
        value = getattr(part, name)
        if name.startswith("_") or callable(value):
            return value
        key = f"{place}.{name}".lstrip(".")
        if key == "views" or type(value).__name__.endswith("Settings"):
            return Watched(value, key, seen)
        self._note(key)
        return value

    def get(self, name: str) -> Any:
        return self[name] if name in self._watched[0] else None

    def __getitem__(self, name: str) -> Any:
        self._note(f"views.{name}")
        return self._watched[0][name]

    def _note(self, key: str) -> None:
        if getattr(_at, "stage", None):
            self._watched[2].setdefault(_at.stage, set()).add(key)


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch) -> dict[str, set[str]]:
    """Return the keys that each stage reads while it is created, begins, steps and finishes."""
    seen: dict[str, set[str]] = {}
    for stage in _every_stage():
        for part in ("__init__", "begin", "step", "finish"):
            monkeypatch.setattr(stage, part, _watching(stage, getattr(stage, part)))
    open_inputs = fingerflow.pipeline.run.open_inputs

    class WatchedInputs(Inputs):
        def __getattribute__(self, name: str) -> Any:
            key = {"times": "recording.times", "gauge_length_mm": "fields.gauge_length_mm"}.get(name)
            if key and getattr(_at, "stage", None):
                seen.setdefault(_at.stage, set()).add(key)
            return super().__getattribute__(name)

    def opened(scene: Scene, *given: Any, **named: Any) -> Inputs:
        inputs = open_inputs(scene, *given, **named)
        inputs.scene = Watched(scene, "", seen)  # type: ignore[assignment]
        inputs.__class__ = WatchedInputs
        return inputs

    monkeypatch.setattr(fingerflow.pipeline.run, "open_inputs", opened)
    # The number of frames belongs to the identity of the recording.
    monkeypatch.setattr(RunContext, "__len__", lambda trial: len(trial.inputs.recording))
    return seen


def _watching(kind: type[Stage], act: Callable[..., Any]) -> Callable[..., Any]:
    def watched(stage: Stage, *given: Any) -> Any:
        outer, _at.stage = getattr(_at, "stage", None), type(stage).name
        try:
            return act(stage, *given)
        finally:
            _at.stage = outer

    return watched


def _declared(stage: type[Stage]) -> Iterator[str]:
    yield from stage.settings
    for other in (*stage.after, *stage.same_pass):
        yield from _declared(other)


def _press(folder: Path) -> tuple[Path, list[str] | None]:
    """Write a press with settings that only non-default values read; return its scene file and all its outputs."""
    write_recording(folder, TINY_PRESS)
    others = {'points_from = "recorded"': 'points_from = "enhanced"', '"reference_frame"': '"per_frame"'}
    scene = load_scene(edit_scene(folder, others))
    names = [name for name in OUTPUTS if all(map(scene.has, VARIABLES[name].needs))]
    return folder / "scene.toml", [name for name in names if name not in by_name(SLIP)]


def _slip(folder: Path) -> tuple[Path, list[str] | None]:
    write_recording(folder, PartialSlip(n_frames=12, frame_rate=12.0, frames_before_trigger=1, **SMALL_SLIP))
    return folder / "scene.toml", None


def _dense_flow_slip(folder: Path) -> tuple[Path, list[str] | None]:
    _, outputs = _slip(folder)
    return edit_scene(folder, {'\ndisplacement = "points"': '\ndisplacement = "dense_flow"'}), outputs


@pytest.mark.parametrize("make", [_press, _slip, _dense_flow_slip])
def test_stages_look_at_no_setting_that_they_do_not_name(
    make: Callable[[Path], tuple[Path, list[str] | None]], tmp_path: Path, looks: dict[str, set[str]]
) -> None:
    """A stage reads only settings declared by this stage or a stage before; otherwise a change of a setting would go
    unnoticed.
    """
    path, outputs = make(tmp_path / "trial")
    scene = load_scene(path)
    stages = {one.name: one for one in plan(outputs, scene).stages}
    process(scene, outputs)
    assert set(looks) <= set(stages)
    for name, seen in looks.items():
        declared = {"path", *_declared(stages[name])}
        unnamed = {key for key in seen if not any(key == one or key.startswith(f"{one}.") for one in declared)}
        assert not unnamed, f"{name} reads {unnamed}"
    assert {"fields.strain", "fields.gauge_length_mm", "recording.times"} <= looks["deformation"]
