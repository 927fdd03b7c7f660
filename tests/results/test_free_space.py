"""Tests that results too large for memory or disk are refused before the computation, and that an interrupted result
leaves nothing.
"""

import shutil
from collections import namedtuple
from pathlib import Path

import pytest

from fingerflow import load_scene, process
from fingerflow.errors import FingerflowError
from fingerflow.pipeline.plan import VARIABLES, plan
from fingerflow.results import free_space as room
from fingerflow.results.result import save_result
from fingerflow.schema.scene import Scene

Usage = namedtuple("Usage", "total used free")


@pytest.fixture(scope="module")
def scene(tiny_press: Path) -> Scene:
    return load_scene(tiny_press / "scene.toml")


def test_the_size_is_that_of_what_comes_out(scene: Scene) -> None:
    """The expected size is up to 1.25 times that of the result, because the estimate has two triangles per point, also
    at the border.
    """
    result = process(scene)
    given = [one for stage in plan(None, scene).stages for one in stage.gives if one.unasked]
    expected = room.size_of_results(given, result.sizes["frame"], result.sizes["point"])
    assert result.nbytes < expected < 1.25 * result.nbytes
    assert {one.name for one in given} <= set(VARIABLES)


def test_no_memory(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    memory = namedtuple("memory", "available")
    monkeypatch.setattr(room.psutil, "virtual_memory", lambda: memory(1000))
    with pytest.raises(FingerflowError, match=r"GB of memory, and 0\.00 GB are free; write them to a file .*to="):
        process(scene)


@pytest.mark.parametrize(("share", "fits"), [(0.98, True), (1.0, True), (1.02, False)])
def test_what_is_free_is_the_limit(share: float, fits: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Results that need 98 % of memory or disk are begun, and those that need 102 % are refused with both numbers."""
    free = 5_000_000_000
    memory = namedtuple("memory", "available")
    monkeypatch.setattr(room.psutil, "virtual_memory", lambda: memory(free))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(2 * free, free, free))
    checks = (
        (lambda: room.check_memory(share * free), f"take {5 * share:.2f} GB of memory, and 5.00 GB are free"),
        # A file takes at least seven tenths of its data; one byte less for rounding.
        (lambda: room.check_disk(tmp_path / "a.h5", share * free / 0.7 - 1), f"{5 * share:.2f} GB are needed and 5.00"),
        (lambda: room.check_write(tmp_path / "a.h5", int(share * free) - (64 << 20)), f"{5 * share:.2f} GB are needed"),
    )
    for check, sentence in checks:
        if fits:
            check()
        else:
            with pytest.raises(FingerflowError, match=sentence):
                check()


@pytest.mark.parametrize("free", [10, 1 << 20])
def test_no_room_on_the_disk(scene: Scene, free: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = process(scene, ["real_contact_area"])
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(100, 90, free))
    with pytest.raises(FingerflowError, match=r"GB are needed and 0\.00 GB of the disk are free"):
        process(scene, to=tmp_path / "result.h5")
    with pytest.raises(FingerflowError, match="GB are needed"):
        save_result(result, tmp_path / "result.h5")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("writes", [1, 40])
def test_a_disk_that_fills_meanwhile(
    scene: Scene, writes: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If the disk becomes full during a run, an older result stays and nothing of the new one remains."""
    save_result(process(scene, ["real_contact_area"]), tmp_path / "result.h5")
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
