"""Tests of which trials and stages must be computed again."""

import os
from pathlib import Path

import numpy as np
import pytest

from fingerflow import load_scene
from fingerflow.pipeline.reuse import WHOLE_BYTES
from fingerflow.study.cache_keys import describe_file, trial_keys


@pytest.fixture
def folder(lab: Path) -> Path:
    return lab / "p01/0um/trial1"


def test_a_recording_counts_by_its_content(folder: Path) -> None:
    scene = load_scene(folder / "scene.toml")
    before = trial_keys(scene)
    os.utime(folder / "frames.npy", ns=(1, 1))
    touched = trial_keys(scene, before.inputs)
    assert touched.row == before.row
    assert not before.changed_inputs(touched)
    frames = np.load(folder / "frames.npy")
    frames[5, 50, 50] ^= 1
    np.save(folder / "frames.npy", frames)
    assert trial_keys(scene, before.inputs).result != before.result


def test_a_large_file_that_was_touched_is_not_certainly_the_same(tmp_path: Path) -> None:
    path = tmp_path / "large.bin"
    path.write_bytes(bytes(WHOLE_BYTES + 1))
    before = describe_file(path)
    assert describe_file(path, before).digest == before.digest
    os.utime(path, ns=(1, 1))
    assert describe_file(path, before).digest != before.digest


@pytest.mark.parametrize("size", [4096, WHOLE_BYTES + 1])
@pytest.mark.parametrize("replaced", [True, False])
def test_a_file_of_the_same_size_and_time_is_read_again(size: int, replaced: bool, tmp_path: Path) -> None:
    path, other = tmp_path / "a.bin", tmp_path / "b.bin"
    path.write_bytes(bytes(size))
    before = describe_file(path)
    (other if replaced else path).write_bytes(b"1" * size)
    if replaced:
        other.replace(path)
    os.utime(path, ns=(before.modified, before.modified))
    now = describe_file(path, before)
    assert (now.size, now.modified) == (before.size, before.modified)
    assert now.digest != before.digest


def test_hidden_files_do_not_change_a_folder_of_images(tmp_path: Path) -> None:
    (tmp_path / "1.png").write_bytes(b"x")
    before = describe_file(tmp_path)
    (tmp_path / "._1.png").write_bytes(b"y")
    (tmp_path / "Thumbs.db").write_bytes(b"z")
    assert describe_file(tmp_path).digest == before.digest
