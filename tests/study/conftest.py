"""A folder of small recordings as a lab has it: two participants, two conditions, each trial a press of its own."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import dask
import numpy as np
import pytest
from distributed import LocalCluster

from fingerflow.study.init import init_study
from fingerflow.study.manifest import Manifest, load_manifest
from fingerflow.synthetic import Press, write_recording

PRESS = Press(
    n_frames=8, frame_rate=8.0, frames_before_trigger=1, frame_shape=(96, 240), finger=(1.8, 1.5), semi_axes=(1.3, 1.1)
)
TRIALS = [(participant, condition, trial) for participant in (1, 2) for condition in (0, 2) for trial in (1, 2)]


@pytest.fixture(scope="session")
def one_press(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("one") / "press"
    write_recording(folder, PRESS)
    return folder


@pytest.fixture
def lab(one_press: Path, tmp_path: Path) -> Path:
    """Folders such as p01/2um/trial1, with answers.csv beside; each recording differs in a pixel of the glass."""
    folder = tmp_path / "lab"
    lines = ["participant,trial,condition,answer"]
    for number, (participant, condition, trial) in enumerate(TRIALS):
        place = folder / f"p{participant:02d}" / f"{condition}um" / f"trial{2 * (condition > 0) + trial}"
        shutil.copytree(one_press, place)
        frames = np.load(place / "frames.npy")
        frames[:, 0, -1] = number
        np.save(place / "frames.npy", frames)
        lines.append(f"{participant:02d},{2 * (condition > 0) + trial},{condition},{number % 2}")
    (folder / "answers.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


@pytest.fixture
def study(lab: Path) -> Manifest:
    init_study(lab, lab / "answers.csv")
    return load_manifest(lab)


@pytest.fixture(scope="session")
def scheduler() -> Iterator[str]:
    """The address of a scheduler whose one worker is a thread here: no process has to load torch.

    A test of another room may stand in the way of that thread for minutes: it is not given up for that.
    """
    with (
        dask.config.set({"distributed.scheduler.worker-ttl": None}),
        LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp://"
        ) as cluster,
    ):
        yield str(cluster.scheduler_address)
