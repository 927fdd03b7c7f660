"""A bundle for the compiled library, and a stream of it, whose frames have known positions and areas.

The topography view shows ten spots of different strength on a plain ground, one for each point: point k is spot k.
Points whose spots are absent are lost. Dark pixels of the contact view are in contact: without a median filter each of
them counts.
"""

import json
import logging
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

from fingerflow import player
from fingerflow.schema.recipe import ContactCells, GaugeSettings, PointSettings, Recipe, ViewRecipe
from tests.small_trials import write_library_bundle

HEIGHT, WIDTH, POINTS = 64, 96, 10
GLASS, TOUCHED, GROUND = 200, 20, 90  # grey levels
SPOTS = np.array([(12 + 18 * (k % 5), 18 + 28 * (k // 5)) for k in range(POINTS)], float)  # (x, y) px
PLACES = SPOTS + np.array([2, -1])  # (x, y) px of the points seeded on the spots
_BUMPS = ((-1.8, -1.2, 1.0), (2.0, -0.9, -1.5), (0.4, 2.1, 0.5))  # x, y (px) and height of bumps of a spot
_WIDTH = 1.3  # px, width of a bump


def parse_recipe(bit_depth: int = 8) -> Recipe:
    """Return the recipe of the bundle."""
    return Recipe(
        views=ViewRecipe(height=HEIGHT, width=WIDTH, bit_depth=bit_depth),
        contact=ContactCells(median_px=1, gross_radius_px=4),
        tracking=PointSettings(points=POINTS, window_px=9, search_px=4),
        fields=GaugeSettings(gauge_length_mm=24.0),
    )


def write_bundle(folder: Path, bit_depth: int = 8) -> Path:
    """Write the bundle, and return its folder."""
    return write_library_bundle(folder, parse_recipe(bit_depth))


def write_scene(path: Path, extra: str = "", background: str = "empty.npy") -> Path:
    """Write a scene whose frames hold the topography view on the left and the contact view on the right; return its
    path.
    """
    np.save(path.parent / "empty.npy", np.full((HEIGHT, 2 * WIDTH), GLASS, np.uint8))
    path.write_text(
        f"""[views.contact]
rows = [0, {HEIGHT}]
columns = [{WIDTH}, {2 * WIDTH}]
[views.topography]
rows = [0, {HEIGHT}]
columns = [0, {WIDTH}]
[background]
frames = "{background}"
[calibration]
mm_per_px = 0.5
topography_to_contact = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
[contact]
threshold = 0.5
{extra}
"""
    )
    return path


def frame(
    found: int = POINTS, contact_px: int = 0, moved: float = 0.0, stretched: float = 0.0, elsewhere: int = 0
) -> np.ndarray[Any, Any]:
    """Return a frame (HEIGHT, 2 * WIDTH) of uint8 with `found` spots, in which `contact_px` pixels touch, row by row.

    The skin has moved by `moved` px in x and is stretched by the share `stretched` about the middle of the view. The
    `elsewhere` weakest spots lie 9 px lower, out of reach of the search, so that their points are lost.
    """
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    middle = np.array([WIDTH / 2, HEIGHT / 2])
    x, y = ((one - at) / (1 + stretched) + at for one, at in ((x - moved, middle[0]), (y, middle[1])))
    ground = np.full((HEIGHT, WIDTH), float(GROUND))
    for k, (right, down) in enumerate(SPOTS[:found]):
        down += 9 * (k >= POINTS - elsewhere)
        for along, across, height in _BUMPS:
            away = (x - right - along) ** 2 + (y - down - across) ** 2
            ground += height * (80 - 5 * k) * np.exp(-away / (2 * _WIDTH**2))
    contact = np.full(HEIGHT * WIDTH, GLASS)
    contact[:contact_px] = TOUCHED
    views = np.round(ground), contact.reshape(HEIGHT, WIDTH)
    return np.concatenate(views, axis=1).clip(0, 255).astype(np.uint8)


class Ended(NamedTuple):
    """The end of a stream: exit code, summary (empty after an error), the text of stderr and of the log, and the
    results if there are any.
    """

    code: int
    summary: dict[str, Any]
    said: str
    results: player.StreamResults


class Stream:
    """Runs `player.main` in a folder of its own."""

    def __init__(
        self,
        folder: Path,
        capsys: pytest.CaptureFixture[str],
        caplog: pytest.LogCaptureFixture,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        self.folder = folder
        self.bundle = write_bundle(folder / "bundle")
        self.scene = write_scene(self.bundle / "scene.toml")
        self.play: Callable[[list[str]], int] = player.main
        self._capsys, self._caplog, self._monkeypatch = capsys, caplog, monkeypatch
        caplog.set_level(logging.INFO)

    def camera(self, make: Callable[[], Any]) -> tuple[str, str]:
        """Return the command-line arguments of a stream whose camera the function `make` of a test opens."""
        name = "camera_of_the_test"
        self._monkeypatch.setitem(sys.modules, name, SimpleNamespace(make=make))
        return "--camera", f"{name}:make"

    def recorded(self, count: int) -> tuple[str, str]:
        """Return the arguments for a file of `count` frames, of which frame k has 10 k pixels in contact."""
        np.save(self.folder / "frames.npy", np.stack([frame(contact_px=10 * k) for k in range(count)]))
        return "--source", str(self.folder / "frames.npy")

    def frames(self, frames: Iterable[Any]) -> tuple[str, str]:
        """Return the command-line arguments of a stream whose camera gives `frames` in turn and raises the exceptions
        among them.
        """
        left = iter(frames)

        def grab() -> Any:
            found = next(left, None)
            if isinstance(found, Exception):
                raise found
            return found

        return self.camera(lambda: grab)

    def run(self, *arguments: str) -> Ended:
        output = self.folder / "results"
        given = [str(self.bundle), "--output", str(output), "--threads", "1", *arguments]
        code = self.play(given if "--page" in arguments else [*given, "--page", "off"])
        said = self._capsys.readouterr()
        results: Any = player.read_results(output) if output.exists() else None
        return Ended(code, json.loads(said.out) if said.out else {}, said.err + self._caplog.text, results)

    def refused(self, *arguments: str) -> str:
        """Return the text of stderr and of the log of a stream that ends with an error of the user and leaves no
        results.
        """
        ended = self.run(*arguments)
        assert ended.code == 2
        assert ended.results is None
        return ended.said
