"""Results that do not fit are refused before they are computed, and nothing is left of those that no longer do."""

import shutil
from collections import namedtuple
from pathlib import Path

import pytest

from fingerflow import load_scene, process, room
from fingerflow.errors import FingerflowError
from fingerflow.plan import VARIABLES, plan
from fingerflow.result import save_result
from fingerflow.scene import Scene
from fingerflow.synthetic import Press, write_recording

Usage = namedtuple("Usage", "total used free")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder = tmp_path_factory.mktemp("room") / "press"
    write_recording(
        folder,
        Press(
            n_frames=8,
            frame_rate=8.0,
            frames_before_trigger=1,
            frame_shape=(96, 240),
            finger=(1.8, 1.5),
            semi_axes=(1.3, 1.1),
        ),
    )
    return load_scene(folder / "scene.toml")


def test_the_size_is_that_of_what_comes_out(scene: Scene) -> None:
    """Of as many points as there were: two triangles each, less those at the border."""
    result = process(scene)
    stages = plan(None, scene).stages
    given = [one for stage in stages for one in stage.gives if one.unasked]
    expected = room.size_of_results(given, result.sizes["frame"], result.sizes["point"])
    assert result.nbytes < expected < 1.25 * result.nbytes
    assert {one.name for one in given} <= set(VARIABLES)


def test_no_memory(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    memory = namedtuple("memory", "available")
    monkeypatch.setattr(room.psutil, "virtual_memory", lambda: memory(1000))
    with pytest.raises(FingerflowError, match=r"GB of memory, and 0\.00 GB are free; write them to a file .*to="):
        process(scene)


@pytest.mark.parametrize("free", [10, 1 << 20])
def test_no_room_on_the_disk(scene: Scene, free: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = process(scene, ["real_contact_area"])
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(100, 90, free))
    with pytest.raises(FingerflowError, match=r"GB are needed and 0\.00 GB of the disk are free"):
        process(scene, to=tmp_path / "result.h5")
    with pytest.raises(FingerflowError, match="GB are needed"):
        save_result(result, tmp_path / "result.h5")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("writes", [1, 5, 40])
def test_a_disk_that_fills_meanwhile(
    scene: Scene, writes: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An older result stays; of the new one nothing does."""
    result = process(scene, ["real_contact_area"])
    save_result(result, tmp_path / "result.h5")
    before = (tmp_path / "result.h5").read_bytes()
    asked = 0

    def usage(_: Path) -> Usage:
        nonlocal asked
        asked += 1
        return Usage(1 << 40, 0, 1 << 30 if asked < writes + 2 else 1 << 20)

    monkeypatch.setattr(shutil, "disk_usage", usage)
    with pytest.raises(FingerflowError, match="of the disk are free; nothing was left there"):
        process(scene, to=tmp_path / "result.h5")
    assert asked == writes + 2
    assert [path.name for path in tmp_path.iterdir()] == ["result.h5"]
    assert (tmp_path / "result.h5").read_bytes() == before
