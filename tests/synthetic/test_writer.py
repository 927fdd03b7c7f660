import errno
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fingerflow.errors import FingerflowError
from fingerflow.synthetic import (
    Bump,
    Camera,
    PartialSlip,
    Press,
    RidgeTexture,
    Slide,
    SyntheticScene,
    rebuild_scene,
    write_recording,
)

SMALL: dict[str, Any] = {
    "n_frames": 4,
    "frames_before_trigger": 1,
    "frame_shape": (64, 160),
    "finger": (1.0, 0.8),
    "semi_axes": (0.7, 0.6),
}


@pytest.mark.parametrize(
    "scene",
    [
        Press(**SMALL, rise_time=0.01, contact_time=0.0, bumps=(Bump(centre=(0.1, 0.0), width=1.0, dilation=0.02),)),
        Slide(**SMALL, creep=0.1, travel=0.1, camera=Camera(bit_depth=12, seed=5), texture=RidgeTexture(seed=3)),
        PartialSlip(**SMALL, creep=0.1, travel=0.1, collapse=0.001, force_noise=0.02),
    ],
    ids=["press 8 bit", "slide 12 bit", "partial slip"],
)
def test_folder_holds_the_scene(scene: SyntheticScene, tmp_path: Path) -> None:
    folder = tmp_path / "trials" / "one"
    write_recording(folder, scene)
    assert [path.name for path in folder.parent.iterdir()] == ["one"]

    frames = np.load(folder / "frames.npy", mmap_mode="r")
    assert frames.shape == (4, 64, 160)
    assert frames.dtype == scene.render(0).dtype
    for number in range(4):
        np.testing.assert_array_equal(frames[number], scene.render(number))

    empty, dark = np.load(folder / "empty.npy"), np.load(folder / "dark.npy")
    np.testing.assert_allclose(empty, np.mean([scene.empty(number) for number in range(8)], axis=0), rtol=1e-6)
    np.testing.assert_allclose(dark, np.mean([scene.dark(number) for number in range(8)], axis=0), rtol=1e-6)

    table = (folder / "forces.csv").read_text(encoding="utf-8").splitlines()
    assert table[0] == "time (s),normal_force (N),tangential_force (N),trigger (V)"
    samples = np.array([[float(cell) for cell in line.split(",")] for line in table[1:]])
    np.testing.assert_allclose(samples, np.stack(scene.forces(), axis=1), atol=1e-6)

    rebuilt = rebuild_scene(folder)
    assert rebuilt == scene
    np.testing.assert_array_equal(rebuilt.render(3), frames[3])
    points = np.array([[1.2, 1.1], [1.4, 1.0]])
    np.testing.assert_array_equal(rebuilt.truth.displacement(points, 3), scene.truth.displacement(points, 3))


def test_an_existing_folder_is_not_touched(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(FingerflowError, match="exists already"):
        write_recording(tmp_path, Press(**SMALL))
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize(
    ("owner", "name", "error"),
    [
        (os, "posix_fallocate", OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))),
        (np, "savetxt", OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))),
        (Press, "dark", KeyboardInterrupt()),
        (Press, "render", OSError("no space left")),
    ],
)
def test_a_failure_leaves_nothing_behind(
    owner: Any, name: str, error: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Disk space is allocated before the frames are written, as a write to mapped memory without space would end the
    process.
    """

    def fail(*_: Any, **__: Any) -> None:
        raise error

    monkeypatch.setattr(owner, name, fail, raising=False)
    full = r"press cannot be written \(No space left on device\); make"
    expected = KeyboardInterrupt if name == "dark" else FingerflowError
    with pytest.raises(expected, match=full if owner in (os, np) else ""):
        write_recording(tmp_path / "press", Press(**SMALL))
    assert list(tmp_path.iterdir()) == []
