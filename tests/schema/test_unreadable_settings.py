"""Tests of scenes, calibrations, bundles and stream folders that no reader can read: a one-line error each, without
waiting.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fingerflow.errors import FingerflowError
from fingerflow.results.stream_folder import read_results
from fingerflow.schema.calibration_file import read_calibration
from fingerflow.schema.recipe import load_recipe
from fingerflow.schema.scene import load_scene
from fingerflow.study.cache_keys import describe_file
from fingerflow.study.manifest import load_manifest

DEEP = "[" * 200_000


@pytest.mark.parametrize("read", [load_scene, read_calibration, describe_file, lambda path: read_results(path.parent)])
def test_a_pipe_is_not_waited_for(tmp_path: Path, read: Callable[[Path], Any]) -> None:
    os.mkfifo(path := tmp_path / "header.json")
    with pytest.raises(FingerflowError, match=r"header\.json: .*is a pipe, not a file; copy"):
        read(path)


@pytest.mark.parametrize("read", [load_scene, read_calibration, load_recipe, load_manifest])
@pytest.mark.parametrize(("value", "said"), [(DEEP, "recursion"), ("9" * 5000, "digits")])
def test_values_beyond_all_measure(tmp_path: Path, read: Callable[[Path], Any], value: str, said: str) -> None:
    (tmp_path / "a.toml").write_text(f"a = {value}")
    with pytest.raises(FingerflowError, match=rf"a\.toml:? .*{said}"):
        read(tmp_path / "a.toml")


@pytest.mark.parametrize(
    ("text", "said"), [(DEEP, "recursion"), *((f'{{"format": {n}}}', f"of format {n}, ") for n in "19")]
)
def test_headers_of_results_that_the_player_cannot_read(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "header.json").write_text(text)
    with pytest.raises(FingerflowError, match=said):
        read_results(tmp_path)


@pytest.mark.parametrize("name", ["a\\u0000b", "x" * 5000])
def test_a_name_that_no_file_can_have(tmp_path: Path, name: str) -> None:
    (tmp_path / "a.toml").write_text(f'[recording]\nframes = "{name}"\n')
    with pytest.raises(FingerflowError, match=r"a\.toml, line 2: recording\.frames is .*cannot? be looked up|no path"):
        load_scene(tmp_path / "a.toml")
