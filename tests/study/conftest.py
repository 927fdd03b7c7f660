"""Fixtures: the study of `lab`, and a scheduler for it."""

from collections.abc import Iterator
from pathlib import Path

import dask
import pytest
from distributed import LocalCluster

from fingerflow.study.init import init_study
from fingerflow.study.manifest import Manifest, load_manifest
from fingerflow.study.run_study import run_study
from tests.study.lab import write_files, write_lab


@pytest.fixture
def lab(tiny_press: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "lab"
    write_files(folder, tiny_press)
    return folder


@pytest.fixture
def study(lab: Path) -> Manifest:
    init_study(lab, lab / "answers.csv")
    return load_manifest(lab)


@pytest.fixture(scope="session")
def undisturbed(tiny_press: Path, tmp_path_factory: pytest.TempPathFactory, scheduler: str) -> Manifest:
    """Return the same study in another folder, run once: the reference of tables and results."""
    folder = tmp_path_factory.mktemp("undisturbed") / "lab"
    write_lab(folder, tiny_press)
    study = load_manifest(folder)
    assert not run_study(study, scheduler, progress=False).interrupted
    return study


@pytest.fixture(scope="session")
def scheduler() -> Iterator[str]:
    """Return the address of a scheduler whose worker is a thread of this process, so that no process must load torch.

    A test of another module may block that thread for minutes, so the worker has no time limit.
    """
    with (
        dask.config.set({"distributed.scheduler.worker-ttl": None}),
        LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp://"
        ) as cluster,
    ):
        yield str(cluster.scheduler_address)
