"""Tests of bad frames recognised in a stream, without later frames: by their light and by their distance from earlier
frames.
"""

import re
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fingerflow.engines.engine import Array
from fingerflow.schema.variables import FRAME_STATUS
from fingerflow.tracker import frame_tracker
from fingerflow.tracker.block_means import block_means
from fingerflow.tracker.frame_distances import LONGEST, PixelSamples, squared_distances_before
from fingerflow.tracker.frame_jumps import jumps_and_returns
from fingerflow.tracker.stream_frame_quality import FrameCheck

GLASS = np.full((192, 240), 200.0)


NOISE = 2.0  # grey levels


def _view(skin: Array, number: int) -> Array:
    """Return a picture of skin (192, 240) with noise, (1, 1, 192, 240) of uint8."""
    noise = NOISE * np.random.default_rng(number).standard_normal(skin.shape)
    return np.clip(np.round(skin + noise), 0, 255).astype(np.uint8)[None, None]


def _skin(seed: int = 2) -> Array:
    """Return the grey levels (192, 300) of ridges 12 px apart, in three random directions."""
    generator = np.random.default_rng(seed)
    y, x = np.mgrid[:192, :300]
    angles = generator.uniform(0, np.pi, 3)
    return 120 + 15 * sum(np.sin((np.cos(one) * x + np.sin(one) * y) * np.pi / 6) for one in angles)


def _moved(skin: Array, px: float) -> Array:
    whole, part = divmod(px, 1)
    left, right = (skin[:, int(whole) + k : int(whole) + k + 240] for k in range(2))
    return (1 - part) * left + part * right


def _statuses(skins: list[Array], noise: Iterable[int] = range(99), end: bool = True) -> list[str]:
    """Return the status names of frames with a contact view only, in order, as they become known; equal numbers in
    `noise` give two frames the same noise.
    """
    check = FrameCheck(GLASS, 0 * GLASS, 8)
    told: list[int] = []
    for number, (skin, seed) in enumerate(zip(skins, noise, strict=False)):
        told += check.update(check.inspect(number, {"contact_view": _view(skin, seed)}))
    return [FRAME_STATUS[one] for one in told + (check.settle() if end else [])]


def test_skin_that_moves_is_no_jump() -> None:
    """Every frame is usable while skin slides faster and faster, and when it jumps by 5 px and stays there."""
    skin = _skin()
    assert _statuses([_moved(skin, px) for px in np.cumsum(np.linspace(0, 1.0, 40))]) == ["usable"] * 40
    assert _statuses([_moved(skin, 0.1 * k + 5 * (k >= 20)) for k in range(40)]) == ["usable"] * 40


def test_a_frame_between_dark_ones_counts() -> None:
    """Skin moves on in the dark: the step from frame 1 to frame 3 is that of two frames, live and recorded."""
    skins = [_moved(_skin(), 0.6 * k) for k in range(20)]
    skins[0] = skins[2] = np.zeros((192, 240))
    assert _statuses(skins) == ["dark", "usable", "dark"] + ["usable"] * 17
    frames = np.concatenate([_view(skin, k)[0] for k, skin in enumerate(skins)])
    usable = ~np.isin(np.arange(20), (0, 2))
    assert not jumps_and_returns(squared_distances_before(PixelSamples.of(block_means(frames)[2]), None), usable).any()


@pytest.mark.parametrize(("length", "later"), [(1, -15), (2, 10), (LONGEST, 20)])
def test_frames_of_another_moment_are_told(length: int, later: int) -> None:
    """Up to `LONGEST` frames of another moment, while skin slides by 0.1 px a frame, are recognised as soon as the
    picture returns, and no other frames are.
    """
    skin, moments = _skin(), np.arange(50)
    moments[30 : 30 + length] += later
    found = _statuses([_moved(skin, 2 + 0.1 * k) for k in moments])
    assert found == ["usable"] * 30 + ["jumps_and_returns"] * length + ["usable"] * (20 - length)


def test_a_frame_there_and_back_is_told_unless_a_finger_vibrates() -> None:
    """Frames that jump and return are bad until the fourth within sixteen frames, which is motion; a jump in the last
    frame, after which nothing is known, is bad.
    """
    place, away = _skin(2)[:, :240], _skin(3)[:, :240]
    places = (20, 24, 28, 32)
    found = _statuses([away if number in (*places, 59) else place for number in range(60)])
    assert [found[k] for k in places] == ["jumps_and_returns"] * 3 + ["usable"]
    assert [k for k, one in enumerate(found) if one != "usable"] == [20, 24, 28, 59]


def test_flickering_light_is_no_bad_frame_once_it_is_known() -> None:
    """Of a lamp that flickers by a fifth at 115 Hz, at 300 frames/s, at most nine frames count as bad, until the
    flicker is known.
    """
    found = _statuses([_skin()[:, :240] * (1 + 0.2 * np.sin(2.4 * k)) for k in range(60)])
    assert [one != "usable" for one in found].count(True) <= 9
    assert found[14:57] == ["usable"] * 43


def test_a_fading_lamp_leaves_no_frame_undecided() -> None:
    """While the lamp is off, every frame is decided, also that in which it faded: undecided frames occupy buffers."""
    lamp = [1.0] * 20 + [0.5] + [0.0] * 30
    assert _statuses([_skin()[:, :240] * share for share in lamp], end=False) == ["usable"] * 21 + ["dark"] * 30


def _disorder(picture: Array, draw: np.random.Generator, size: int) -> Array:
    """Return a picture whose rows and columns of blocks of `size` px are in disorder."""
    groups = [draw.permutation(side // size)[:, None] * size + np.arange(size) for side in picture.shape]
    return picture[np.ix_(*map(np.ravel, groups))]


_SPOIL: dict[str, Any] = {
    "noise": lambda picture, draw: draw.normal(127, 70, picture.shape),
    "noise over it": lambda picture, draw: picture + draw.normal(0, 70, picture.shape),
    "lines": lambda picture, draw: draw.permutation(picture),
    **{f"blocks of {size} px": partial(_disorder, size=size) for size in (8, 16)},
}


@pytest.mark.parametrize("growth", [1.05, 1.2, 1.4])
@pytest.mark.parametrize("kind", _SPOIL)
def test_frames_without_a_picture_count_in_no_number_and_fast_growth_does(growth: float, kind: str) -> None:
    """Eight frames in disorder are excluded, and no other frame of a contact that grows fast."""
    y, x = np.mgrid[:192, :240]
    radius = 24 * np.minimum(growth ** (np.arange(40) / 2), 3.5)
    skins = [np.where(np.hypot(x - 120, y - 96) < size, _skin()[:, :240] - 50, 200) for size in radius]
    skins[22:30] = [_SPOIL[kind](skins[k], np.random.default_rng(k)) for k in range(22, 30)]
    assert _statuses(skins) == ["usable"] * 22 + ["noise"] * 8 + ["usable"] * 10


@pytest.mark.parametrize(("every", "told"), [(12, True), (2, False)])
def test_a_repeated_frame_is_told_where_others_differ(every: int, told: bool) -> None:
    """A repeated frame is recognised if other frames differ; a camera that gives each picture twice has none."""
    repeats = [k for k in range(1, 60) if k % every == 0]
    found = _statuses([_skin()[:, :240]] * 60, [k - (k in repeats) for k in range(60)])
    assert [k for k, one in enumerate(found) if one == "repeated"] == (repeats if told else [])


def test_the_figure_of_the_state_names_every_deque() -> None:
    """The figure is the same in the docstring of the tracker and in the documentation."""
    figure = (frame_tracker.__doc__ or "").partition("writes:\n\n")[2]
    root = Path(__file__).parents[2]
    assert figure in (root / "docs" / "methods" / "tracking.md").read_text(encoding="utf-8")
    for file in (root / "fingerflow" / "tracker").glob("*.py"):
        for name in re.findall(r"self\.(\w+)[^=\n]* = deque\(", file.read_text(encoding="utf-8")):
            assert f"`{name}`" in figure, f"{file.name}: {name}"
