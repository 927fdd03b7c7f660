"""The command line: exit codes, messages, files."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest


def run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    code = "from fingerflow.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], cwd=cwd, capture_output=True, text=True, check=False
    )


def test_info_as_json(tmp_path: Path) -> None:
    np.save(tmp_path / "frames.npy", np.zeros((5, 8, 10), dtype=np.uint8))
    done = run("info", "frames.npy", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert (facts["frames"], facts["rows"], facts["columns"], facts["frame_rate_hz"]) == (5, 8, 10, None)


def test_init_never_overwrites(tmp_path: Path) -> None:
    assert run("init", "scene.toml", cwd=tmp_path).returncode == 0
    before = (tmp_path / "scene.toml").read_text()
    again = run("init", "scene.toml", cwd=tmp_path)
    assert again.returncode == 2
    assert "exists already" in again.stderr
    assert (tmp_path / "scene.toml").read_text() == before


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("info", "nothing.cine"), "nothing.cine"),
        (("process", "nothing.toml"), "nothing.toml"),
        (("export-table", "nothing.h5", "table.csv"), "nothing.h5"),
        (("simulate", "poke", "folder"), "press, slide"),
        (("frobnicate",), "frobnicate"),
    ],
)
def test_mistakes_are_named_without_a_traceback(arguments: tuple[str, ...], said: str, tmp_path: Path) -> None:
    done = run(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())
