"""Tests that outputs replace only outputs of the same command, and leave no temporary files."""

import errno
import os
import signal
import stat
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from fingerflow.errors import FingerflowError
from fingerflow.results.atomic_write import spare, write_atomically
from fingerflow.results.result import is_result, load_result, save_result
from fingerflow.schema.unfinished import unfinished

ROOT = Path(__file__).resolve().parents[2]


def result(value: float = 1.0) -> xr.Dataset:
    return xr.Dataset({"area": ("frame", np.full(3, value))}, attrs={"fingerflow_version": "0"})


@pytest.mark.parametrize(
    ("given", "output"),
    [
        ("a.mraw", "a.cih"),
        ("a.cih", "a.mraw"),
        ("a.mraw", "a.CIHX"),
        ("a.mraw", "a.mraw"),
        ("frames", "frames/1.png"),
        ("frames", "frames/new.png"),
        ("frames", "frames/../frames/2.TIF"),
        ("rec.h5::/cam/frames", "rec.h5"),
    ],
)
def test_inputs_and_what_belongs_to_them_are_spared(tmp_path: Path, given: str, output: str) -> None:
    (tmp_path / "frames").mkdir()
    for name in ("a.mraw", "a.cih", "a.CIHX", "rec.h5", "frames/1.png"):
        (tmp_path / name).write_bytes(b"an input")
    with pytest.raises(FingerflowError, match="would be replaced; give another output"):
        spare(tmp_path / output, tmp_path / given)


@pytest.mark.parametrize(
    ("given", "output"),
    [("a.mraw", "a.h5"), ("a.mraw", "b.cih"), ("frames", "frames/result.h5"), ("frames", "1.png"), ("gone", "a.h5")],
)
def test_what_lies_beside_an_input_is_no_input(tmp_path: Path, given: str, output: str) -> None:
    (tmp_path / "frames").mkdir()
    for name in ("a.mraw", "a.cih", "b.cih", "frames/1.png", "1.png"):
        (tmp_path / name).write_bytes(b"something")
    spare(tmp_path / output, tmp_path / given)


def test_a_result_replaces_results_alone(tmp_path: Path) -> None:
    path = tmp_path / "result.h5"
    save_result(result(1.0), path)
    assert is_result(path)
    save_result(result(2.0), path)
    assert load_result(path)["area"][0] == 2.0
    for content in (b"years of work", b"", b"\x89HDF\r\n\x1a\n and no more"):
        path.write_bytes(content)
        assert not is_result(path)
        with pytest.raises(FingerflowError, match=r"result\.h5 exists and was not written by this.*--overwrite"):
            save_result(result(), path)
        assert path.read_bytes() == content
    save_result(result(3.0), path, overwrite=True)
    assert load_result(path)["area"][0] == 3.0
    os.mkfifo(pipe := tmp_path / "pipe")
    for overwrite in (False, True):
        with pytest.raises(FingerflowError, match=r"pipe (exists and was not|is no file)"):
            save_result(result(), pipe, overwrite)


def test_process_asks_before_it_computes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fingerflow import load_scene, process
    from fingerflow.synthetic import Press, write_recording

    write_recording(tmp_path / "press", Press(n_frames=2, frames_before_trigger=1, frame_shape=(96, 240)))
    scene = load_scene(tmp_path / "press" / "scene.toml")
    (tmp_path / "notes.h5").write_bytes(b"years of work")
    monkeypatch.setattr("fingerflow.pipeline.run._run", lambda *_: pytest.fail("frames were read"))
    inputs = [tmp_path / "press" / name for name in ("forces.csv", "frames.npy", "empty.npy", "scene.toml")]
    for output, overwrite in ((tmp_path / "notes.h5", False), *((path, True) for path in inputs)):
        before = output.read_bytes()
        message = "would be replaced" if overwrite else "--overwrite"  # an input is never replaced
        with pytest.raises(FingerflowError, match=message):
            process(scene, to=output, overwrite=overwrite)
        assert output.read_bytes() == before


def test_pages_videos_and_figures_replace_their_own_alone(tmp_path: Path) -> None:
    from matplotlib.figure import Figure

    from fingerflow.plot.figure_files import PNG
    from fingerflow.report import video_writer, write_report
    from fingerflow.results.atomic_write import is_marked

    trial = result().assign_coords(time=("frame", np.arange(3.0)), frame=np.arange(3))
    trial.attrs |= {"stage_seconds": "{}", "settings": "{}", "warnings": "[]", "mm_per_px": 0.05, "title": "a press",
                    "topography_to_contact": "[[1, 0, 0], [0, 1, 0]]", "strain_measure": "green_lagrange",
                    "frames": "a.npy", "created": "2026-01-01"}  # fmt: skip
    page = write_report(trial, None, tmp_path)
    assert write_report(trial, None, tmp_path) == page  # its own
    PNG.save(Figure(), tmp_path, "ours")
    video_writer.encode_video([np.zeros((32, 32, 3), np.uint8)] * 3, tmp_path / "ours.mp4")
    assert all(map(is_marked, (page, tmp_path / "ours.png", tmp_path / "ours.mp4")))
    page.write_text("<h1>years of work</h1>")
    with pytest.raises(FingerflowError, match=r"report\.html exists and was not written by this command"):
        write_report(trial, None, tmp_path)
    assert page.read_text() == "<h1>years of work</h1>"
    assert is_marked(write_report(trial, None, tmp_path, overwrite=True))
    (tmp_path / "S13.png").write_bytes(b"years of work")
    with pytest.raises(FingerflowError, match=r"S13\.png exists and was not written by this command"):
        PNG.keep_others(tmp_path, "S13", overwrite=False)
    assert (tmp_path / "S13.png").read_bytes() == b"years of work"


@pytest.mark.parametrize("suffix", [".csv", ".mat"])
def test_a_table_replaces_tables_alone(suffix: str, tmp_path: Path) -> None:
    import scipy.io

    from fingerflow.results.tables import export_table, is_table

    trial = result().assign_coords(time=("frame", np.arange(3.0), {"units": "s"}), frame=np.arange(3))
    trial["area"].attrs |= {"units": "mm2", "long_name": "area"}
    trial["time"].attrs["long_name"] = "time"
    table = tmp_path / f"table{suffix}"
    export_table(trial, table)
    assert is_table(table)
    export_table(trial, table)  # its own
    if suffix == ".mat":
        scipy.io.savemat(table, {"work": np.arange(9)})
    else:
        table.write_text("years of work\n")
    before = table.read_bytes()
    with pytest.raises(FingerflowError, match=r"table\..* exists and was not written by this command"):
        export_table(trial, table)
    assert table.read_bytes() == before
    export_table(trial, table, overwrite=True)
    assert is_table(table)


KILLED = """
import os, sys, time
from pathlib import Path
from fingerflow.results.atomic_write import write_atomically

def write(part):
    part.write_text("half")
    print(part.name, flush=True)
    time.sleep(600)

write_atomically(Path(sys.argv[1]), write)
"""


def test_the_content_is_on_the_disk_before_the_name_and_the_name_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, synced = tmp_path / "a.txt", []
    path.write_text("before")

    def sync(file: int) -> None:
        is_folder = stat.S_ISDIR(os.fstat(file).st_mode)
        synced.append(("folder" if is_folder else os.pread(file, 99, 0).decode(), path.read_text()))

    monkeypatch.setattr(os, "fsync", sync)
    write_atomically(path, lambda part: part.write_text("after"))
    assert synced == [("after", "before"), ("folder", "after")]


def test_a_disk_that_fails_at_last_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    path = tmp_path / "a.txt"
    path.write_text("before")
    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(FingerflowError, match=r"a\.txt cannot be written \(Input/output error\); name another place"):
        write_atomically(path, lambda part: part.write_text("after"))
    assert [(one.name, one.read_text()) for one in tmp_path.iterdir()] == [("a.txt", "before")]


def test_what_a_killed_run_left_goes_with_the_next_of_its_kind(tmp_path: Path) -> None:
    path = tmp_path / "result.h5"
    left = []
    for name in ("result.h5", "result.h5", "other.h5"):
        command = [sys.executable, "-c", textwrap.dedent(KILLED), str(tmp_path / name)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as run:
            assert run.stdout is not None
            left.append(run.stdout.readline().strip())
            if name == "other.h5":  # temporary file of another output, whose process runs
                write_atomically(tmp_path / "other.h5", lambda part: part.write_text("whole"))
                assert (tmp_path / left[-1]).exists()
            run.send_signal(signal.SIGKILL)
    mine = unfinished(path)
    mine.write_text("of this process, which lives")
    assert {entry.name for entry in tmp_path.iterdir()} >= {left[2], mine.name, "other.h5"}
    write_atomically(path, lambda part: part.write_text("whole"))
    assert sorted(entry.name for entry in tmp_path.iterdir()) == sorted([left[2], mine.name, "other.h5", "result.h5"])
    (tmp_path / f"{left[0][: left[0].index('-')]}-user-notes.h5").write_text("a hidden file of the user's")
    write_atomically(tmp_path / "other.h5", lambda part: part.write_text("whole"))
    assert not (tmp_path / left[2]).exists()
    assert len(list(tmp_path.glob(".result-user-notes.h5"))) == 1
