"""Tests of runs: computed, skipped and failed trials, and numbers that do not depend on the worker."""

import json
import logging
import re
import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from fingerflow.errors import FingerflowError, NoRoomError
from fingerflow.results.atomic_write import write_atomically
from fingerflow.results.result import load_result, read_own
from fingerflow.study import trial as worker
from fingerflow.study.manifest import Manifest, load_manifest
from fingerflow.study.row import DESCRIBED, READ, measure
from fingerflow.study.run_study import plan_run, run_study
from fingerflow.study.trial_files import FAILED, MEASURED, read_row
from tests.small_trials import edit
from tests.study.blows import end, rows_of, start, start_scheduler, table_of, until, workers_of

_PROVENANCE = {"created", "stage_seconds"}


def _run(study: Manifest, scheduler: str, **options: Any) -> dict[str, str]:
    summary = run_study(study, scheduler, progress=False, **options)
    assert not summary.interrupted
    return {name: one.status for name, one in summary.outcomes.items()}


@pytest.mark.long
def test_a_rerun_does_what_changed_and_nothing_else(study: Manifest, lab: Path, scheduler: str) -> None:
    assert _run(study, scheduler) == {entry.name: MEASURED for entry in study.trials}
    assert plan_run(study) == []
    assert _run(study, scheduler) == {}
    before = table_of(study)
    edit(lab / "study.toml", ("gauge_length_mm = 1.6", "gauge_length_mm = 1.4"))
    changed = load_manifest(lab)
    assert {redo for _, redo, _ in plan_run(changed)} == {"changed"}
    _run(changed, scheduler)
    made = read_row(changed.results / "01_0_1")
    assert made is not None
    assert made.result is not None
    with xr.open_dataset(changed.results / "01_0_1" / made.result, engine="h5netcdf") as result:
        assert "decoding" not in json.loads(result.attrs["stage_seconds"])
    after = table_of(changed)
    assert (before["real_contact_area"] == after["real_contact_area"]).all()
    assert (before["divergence"] != after["divergence"]).all()
    # One result per trial: the earlier result is removed.
    assert all(len(list((changed.results / entry.name).glob("*.h5"))) == 1 for entry in changed.trials)
    frames = np.load(lab / "p02/0um/trial1/frames.npy")
    frames[3] //= 2
    np.save(lab / "p02/0um/trial1/frames.npy", frames)
    ((entry, redo, why),) = plan_run(changed)
    assert (entry.name, redo) == ("02_0_1", "everything")
    assert "recording.frames changed" in why


def test_a_row_has_where_it_comes_from_and_reads_what_it_needs(study: Manifest, scheduler: str) -> None:
    _run(study, scheduler, only="01_0_1")
    row = read_row(study.results / "01_0_1")
    assert row is not None
    assert row.keys is not None
    assert row.result is not None
    path = study.results / "01_0_1" / row.result
    assert measure(read_own(path, READ, DESCRIBED)) == measure(load_result(path)) == (row.row, row.curves)
    assert set(row.keys.inputs) == {"recording.frames", "background.frames", "background.dark", "forces.file"}
    assert {"started", "seconds", "cpu_seconds", "versions", "machine", "code", "threads"} <= set(row.made)
    assert row.made["versions"]["torch"]


def test_failures_are_rows_and_stop_nothing(study: Manifest, lab: Path, scheduler: str, undisturbed: Manifest) -> None:
    broken = [lab / place / "frames.npy" for place in ("p01/0um/trial1", "p01/0um/trial2", "p01/2um/trial3")]
    whole = [path.read_bytes() for path in broken]
    (lab / "p01/0um/trial1/frames.npy").write_bytes(b"no frames")
    (lab / "p01/0um/trial2/frames.npy").unlink()
    frames = np.load(lab / "p01/2um/trial3/frames.npy")
    np.save(lab / "p01/2um/trial3/frames.npy", np.broadcast_to(np.load(lab / "p01/2um/trial3/empty.npy"), frames.shape))
    found = _run(study, scheduler)
    failed = {"01_0_1", "01_0_2", "01_2_3"}
    assert {name for name, status in found.items() if status == FAILED} == failed
    table = table_of(study).set_index("status")
    assert len(table) == len(study.trials)
    assert table.loc[FAILED, "divergence"].isna().all()
    reasons = table.loc[FAILED, "reason"].tolist()
    assert "frames.npy" in reasons[0]
    assert "does not exist" in reasons[1]
    # They are run again only on request, or if the file has changed.
    assert plan_run(study) == []
    assert {entry.name for entry, *_ in plan_run(study, retry_failed=True)} == failed
    for path, content in zip(broken, whole, strict=True):
        path.write_bytes(content)
    assert _run(study, scheduler) == dict.fromkeys(sorted(failed), MEASURED)
    pd.testing.assert_frame_equal(table_of(study), table_of(undisturbed), check_exact=True)


def test_a_digit_of_a_row_and_a_bit_of_a_result_are_missed(study: Manifest, scheduler: str) -> None:
    """A number of a row and a byte of a result, which only digests detect, are computed again as they were."""
    _run(study, scheduler, only="01_0_*")
    expected = table_of(study)
    row, other = (study.results / entry.name for entry in study.trials[:2])
    text = (row / "row.json").read_text(encoding="utf-8")
    number = re.search(r'"divergence": -?0\.0*([1-9])', text)  # a change of the last digit may not change the number
    assert number is not None
    other_digit = str(int(number[1]) % 9 + 1)
    (row / "row.json").write_text(text[: number.start(1)] + other_digit + text[number.end(1) :], encoding="utf-8")
    result = next(other.glob("*.h5"))
    content = bytearray(result.read_bytes())
    content[len(content) // 2] ^= 1
    result.write_bytes(content)
    assert _run(study, scheduler, only="01_0_*") == dict.fromkeys((row.name, other.name), MEASURED)
    pd.testing.assert_frame_equal(table_of(study), expected, check_exact=True)


def test_only_runs_matching_trials_and_refuses_a_pattern_without_any(study: Manifest, scheduler: str) -> None:
    assert set(_run(study, scheduler, only="02_*")) == {entry.name for entry in study.trials if entry.name[:2] == "02"}
    with pytest.raises(FingerflowError, match="no trial has such a name"):
        plan_run(study, only="03_*")
    assert (table_of(study)["status"] == "not run").sum() == 4


def test_a_full_disk_is_tried_again(study: Manifest, scheduler: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise NoRoomError("the disk is full")

    with monkeypatch.context() as patched:
        patched.setattr(worker, "compute", full)
        assert set(_run(study, scheduler, only="01_0_*").values()) == {FAILED}
    assert {entry.name for entry, *_ in plan_run(study, only="01_0_*")} == {"01_0_1", "01_0_2"}

    def no_room(path: Path, text: str) -> None:
        def fails(part: Path) -> None:
            raise OSError(28, "No space left on device")

        write_atomically(path, fails)

    with monkeypatch.context() as patched:
        patched.setattr("fingerflow.study.trial_files.write_text", no_room)
        assert set(_run(study, scheduler, only="01_0_*").values()) == {FAILED}
    assert _run(study, scheduler, only="01_0_*") == {"01_0_1": MEASURED, "01_0_2": MEASURED}


def test_what_nobody_expected_is_a_row_with_its_traceback(
    study: Manifest, scheduler: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker, "measure", lambda result: 1 / 0)
    assert _run(study, scheduler, only="01_0_1") == {"01_0_1": FAILED}
    row = read_row(study.results / "01_0_1")
    assert row is not None
    assert row.reason.startswith("unexpected ZeroDivisionError")
    assert "1 / 0" in row.made["traceback"]


def test_a_worker_of_another_version_is_refused(
    study: Manifest, scheduler: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker, "all_codes", lambda: {"result": "", "row": ""})
    with pytest.raises(FingerflowError, match="has other code for result, row"):
        _run(study, scheduler, only="01_0_1")


def test_two_runs_at_once(study: Manifest, scheduler: str) -> None:
    """A run planned before another run finished leaves the rows of the other run unchanged."""
    late = [entry for entry, *_ in plan_run(study, only="01_0_*")]
    _run(study, scheduler, only="01_0_*")
    stamps = {entry.name: (study.results / entry.name / "row.json").stat().st_mtime_ns for entry in late}
    codes = worker.all_codes()
    for entry in late:
        _, outcome = worker.run_trial((replace(study, trials=(entry,)), "everything"), codes, 1)
        assert outcome.reason == "was done by another run meanwhile"
        assert (study.results / entry.name / "row.json").stat().st_mtime_ns == stamps[entry.name]
    assert not logging.getLogger("tornado.application").isEnabledFor(logging.ERROR)  # of heartbeats after the end


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_processes_that_are_killed_lose_nothing(
    study: Manifest, lab: Path, undisturbed: Manifest, scheduler: str
) -> None:
    """After the client with its workers is killed, then a worker, then Ctrl-C, the final table equals that of an
    undisturbed run bit for bit.
    """
    there, started = rows_of(study), start(lab)
    try:
        until(lambda: rows_of(study) > there, started)
    finally:
        end(started)
    there, started = rows_of(study), start(lab)
    try:
        until(lambda: rows_of(study) > there, started)
        if started.poll() is None:  # else the run ended before the fault
            for worker in workers_of(started)[:1]:
                worker.kill()
        until(lambda: rows_of(study) > there + 1, started)
        started.send_signal(signal.SIGINT)
        started.wait(120)
    finally:
        end(started)
    summary = run_study(study, scheduler, progress=False)
    assert not [one for one in summary.outcomes.values() if one.status == FAILED]
    pd.testing.assert_frame_equal(table_of(study), table_of(undisturbed), check_exact=True)
    for entry in study.trials:
        one, other = (next((where.results / entry.name).glob("*.h5")) for where in (study, undisturbed))
        with xr.open_dataset(one, engine="h5netcdf") as first, xr.open_dataset(other, engine="h5netcdf") as second:
            for name in first.data_vars:
                np.testing.assert_array_equal(first[name].values, second[name].values)
            assert _attributes(first, study) == _attributes(second, undisturbed)
    left = [path for path in study.results.rglob("*") if path.name.startswith(".")]
    assert not left, "a run removes what killed ones have left"


def _attributes(result: xr.Dataset, study: Manifest) -> dict[str, str]:
    """Return the attributes of a result without time, speed and folder of its computation."""
    where = str(study.path.parent)
    return {name: str(value).replace(where, "") for name, value in result.attrs.items() if name not in _PROVENANCE}


@pytest.mark.long
def test_a_scheduler_that_is_killed_loses_nothing(study: Manifest, scheduler: str, undisturbed: Manifest) -> None:
    """If the scheduler, a process with its worker, is killed, the run ends with a message, and the next run completes
    the rest.
    """
    other, address = start_scheduler()
    with other, ThreadPoolExecutor(1) as pool:
        running = pool.submit(run_study, study, address, progress=False)
        until(lambda: rows_of(study) > 0, other)
        other.kill()
        summary = running.result(timeout=300)
    assert "scheduler was lost" in summary.interrupted
    done = {*summary.outcomes}
    assert len(done) < len(study.trials)
    again = _run(study, scheduler)
    assert set(again.values()) == {MEASURED}
    assert not done & set(again)
    pd.testing.assert_frame_equal(table_of(study), table_of(undisturbed), check_exact=True)
