"""Execution of trials by a worker process, which writes results to the trial's folder and returns the outcome."""

import errno
import gc
import logging
import os
import platform
import time
import traceback
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import cv2
import torch

from fingerflow import __version__
from fingerflow.errors import FingerflowError, NoRoomError, is_out_of_memory
from fingerflow.pipeline.run import compute
from fingerflow.results.result import open_result, read_own
from fingerflow.study.cache_keys import Keys, all_codes, describe_file, trial_keys
from fingerflow.study.manifest import Manifest
from fingerflow.study.row import DESCRIBED, READ, measure
from fingerflow.study.trial_files import FAILED, MEASURED, Part, TrialRow, has_result, read_row, write_row

_PASSING = {errno.ENOSPC, errno.EDQUOT, errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EIO, errno.ESTALE, errno.EROFS}
_VERSIONS = ("torch", "numpy", "scipy", "opencv-contrib-python-headless", "xarray", "h5py", "distributed")


def run_trial(task: tuple[Manifest, Part], codes: Mapping[str, str], threads: int) -> tuple[str, TrialRow]:
    """Process one trial, write its result and table row into its folder, and return its name and its table row.

    Args:
        task: manifest of this trial alone, and what to redo: "everything", what settings or code have "changed", or the
            "row" alone.
        codes: the client's `all_codes`, which the worker's must equal.
        threads: number of threads that the worker uses.

    Raises FingerflowError only for a fault of the worker itself: another version of the package.
    """
    different = [part for part, code in codes.items() if all_codes()[part] != code]
    if different:
        raise FingerflowError(
            f"the worker on {platform.node()} has other code for {', '.join(different)} than this computer: install "
            f"the same version of fingerflow on both"
        )
    _set_up_worker(threads)
    started, wall, cpu = datetime.now(UTC), time.perf_counter(), time.process_time()
    manifest, redo = task
    (entry,) = manifest.trials
    folder = manifest.results / entry.name
    keys: Keys | None = None
    trace: dict[str, str] = {}
    try:
        scene = manifest.build_scene(entry)
        stored = read_row(folder)
        keys = trial_keys(scene, stored.keys.inputs if stored is not None and stored.keys is not None else None)
        if stored is not None and stored.status == MEASURED and is_current(stored, keys, folder):
            return entry.name, TrialRow(MEASURED, "was done by another run meanwhile")
        # Other inputs, settings or code give another name.
        path, earlier = folder / f"result-{keys.result}.h5", None
        if redo != "everything" and stored is not None and stored.result and has_result(folder, stored):
            earlier = folder / stored.result
        if redo == "row" and earlier == path:
            with open_result(path) as result:
                row, curves = measure(result)
        else:
            # Overwrite, since an existing file of this name may be damaged and not be recognised as a result.
            compute(scene, path, earlier=earlier, overwrite=True)
            row, curves = measure(read_own(path, READ, DESCRIBED))
        content = replace(describe_file(path), path=path.name)
        trial = TrialRow(MEASURED, keys=keys, result=path.name, content=content, row=row, curves=curves)
    except Exception as error:
        unexpected = not isinstance(error, FingerflowError) and not _is_transient(error)
        reason = f"unexpected {type(error).__name__}: {error}" if unexpected else str(error) or type(error).__name__
        trial = TrialRow(FAILED, reason, _is_transient(error), keys)
        trace = {"traceback": traceback.format_exc()} if unexpected else {}
    made = {
        "started": started.isoformat(timespec="seconds"),
        "seconds": round(time.perf_counter() - wall, 3),
        "cpu_seconds": round(time.process_time() - cpu, 3),
        "redone_from": redo,
        "threads": threads,
        **_machine(),
        **trace,
    }
    try:
        trial = replace(trial, made=made)
        write_row(folder, trial)
    except FingerflowError as error:  # the trial runs again, as it has no row
        trial = TrialRow(FAILED, str(error), passing=True, made=made)
    return entry.name, trial


def is_current(stored: TrialRow, keys: Keys, folder: Path) -> bool:
    """Return True if the stored outcome of a trial is up to date: its cache keys match `keys`, computed from the
    current inputs, settings and code, and the result file that it names is unchanged.
    """
    if stored.keys is None or stored.keys.row != keys.row or stored.keys.changed_inputs(keys):
        return False
    return stored.result is None or has_result(folder, stored)


def _is_transient(error: BaseException | None) -> bool:
    """Return True if an error is transient, such as lack of memory, so that a second run of the trial may succeed."""
    return error is not None and (
        is_out_of_memory(error)
        or isinstance(error, NoRoomError)
        or (isinstance(error, OSError) and error.errno in _PASSING)
        or _is_transient(error.__cause__ or error.__context__)
    )


@cache
def _set_up_worker(threads: int) -> None:
    """Set the threads of a worker, and exempt loaded objects from garbage collection.

    Heartbeats of a worker that is closed meanwhile would print tracebacks, on a busy machine, below a complete run.
    """
    logging.getLogger("tornado.application").setLevel(logging.CRITICAL)
    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)
    gc.collect()
    gc.freeze()


@cache
def _machine() -> dict[str, Any]:
    versions = {"fingerflow": __version__, "python": platform.python_version()}
    for name in _VERSIONS:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    return {
        "versions": versions,
        "code": all_codes(),
        "machine": {"name": platform.node(), "system": platform.platform(), "cores": os.cpu_count()},
    }
