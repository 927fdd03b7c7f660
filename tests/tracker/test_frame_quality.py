"""Frames that cannot be, told without those to come: by their light, and by how far they are from the last ones."""

from typing import Any

import numpy as np
import pytest

from fingerflow.schema.variables import FRAME_STATUS
from fingerflow.tracker.block_means import block_means
from fingerflow.tracker.frame_distances import divide_by_mean
from fingerflow.tracker.stream_frame_quality import USABLE, Blocks, FrameCheck

Array = np.ndarray[Any, Any]
GLASS = np.full((192, 240), 200.0)


def _blocks(means: Array) -> Blocks:
    """Of a contact view alone."""
    return Blocks(means[None], divide_by_mean(means[None])[0], np.log(np.maximum(means, 1)).ravel())


@pytest.mark.parametrize("shape", [(192, 240), (512, 640), (50, 47), (23, 300)])
def test_a_frame_is_known_by_its_block_means(shape: tuple[int, int]) -> None:
    """Of both views, the contact view first; the light is that of the contact view."""
    contact, topography = np.random.default_rng(5).integers(0, 256, (2, *shape), np.uint8)
    check = FrameCheck(contact, np.zeros(shape), 8)
    blocks, _ = check.look({"topography_view": topography[None, None], "contact_view": contact[None, None]})
    both = [block_means(view[None])[0][0] for view in (contact, topography)]
    np.testing.assert_array_equal(blocks.means, both)
    np.testing.assert_array_equal(blocks.even, np.concatenate([divide_by_mean(one[None])[0] for one in both]))
    np.testing.assert_allclose(blocks.light, np.log(both[0]).ravel(), rtol=1e-6)


def test_skin_that_moves_is_no_jump() -> None:
    """Blocks that change by up to three times as much as before, with points lost, are motion; so is any step that is
    not taken back."""
    generator = np.random.default_rng(2)
    check = FrameCheck(GLASS, 0 * GLASS, 8)
    place, step = 150 + 5 * generator.standard_normal((8, 10)), generator.standard_normal((8, 10))
    for number in range(20):
        place = place + 2 * step
        assert check.see(number, _blocks(place), USABLE, 100, False) == USABLE
    assert check.see(20, _blocks(place + 5 * step), USABLE, 10, False) == USABLE
    assert check.see(21, _blocks(place + 60 * step), USABLE, 10, False) is None
    assert check.settle(_blocks(place + 61 * step)) == USABLE
    assert check.see(22, _blocks(place + 61 * step), USABLE, 10, False) == USABLE


def test_a_frame_there_and_back_is_told_unless_a_finger_vibrates() -> None:
    """The third of sixteen frames that come back is motion; so is one behind which nothing is known."""
    generator = np.random.default_rng(2)
    check = FrameCheck(GLASS, 0 * GLASS, 8)
    place, away = 150 + 20 * generator.standard_normal((2, 8, 10))
    status = []
    for number in range(40):
        blocks = _blocks(away if number in (10, 14, 18) else place)
        found = check.see(number, blocks, USABLE, 100, False)
        status.append(check.settle(_blocks(place)) if found is None else found)
    assert [FRAME_STATUS[status[k]] for k in (10, 14, 18)] == ["jumps_and_returns"] * 2 + ["usable"]
    assert sum(one != USABLE for one in status) == 2
    assert check.see(40, _blocks(away), USABLE, 100, False) is None
    assert check.settle(None) == USABLE


@pytest.mark.parametrize("share", [0.1, 0.2])
def test_a_lamp_that_flickers_is_none(share: float) -> None:
    """By a fifth, at 115 Hz under 300 frames/s: some frames are lost until it is known for what it is."""
    check = FrameCheck(GLASS, 0 * GLASS, 8)
    place = np.random.default_rng(2).uniform(60, 160, (8, 10))
    light = 1 + share * np.sin(2.4 * np.arange(60))
    status = [check.see(number, _blocks(place * light[number]), USABLE, 100, False) for number in range(60)]
    assert np.count_nonzero(status) <= 9
    assert not np.any(status[14:])


def test_lines_without_light_are_lost_ones() -> None:
    """Whatever is found of points; lines that stay without light are the camera's, after three frames."""
    view = np.full((1, 1, 512, 640), 180, np.uint8)
    check = FrameCheck(view[0, 0], np.zeros(view.shape[2:]), 8)
    lines = view.copy()
    lines[..., 90:100, :] = 0

    def status(number: int, frame: Array) -> int:
        return check.see(number, *check.look({"contact_view": frame}), 100, False)

    assert [FRAME_STATUS[status(k, lines if k in (3, 6) else view)] for k in range(9)] == [
        "jumps_and_returns" if k in (3, 6) else "usable" for k in range(9)
    ]
    assert [status(9 + k, lines) == USABLE for k in range(6)] == [False, False, False, True, True, True]
    half = view.copy()
    half[..., 90:100, :320] = 0  # a contact does not reach from side to side
    assert check.look({"contact_view": half})[1] == USABLE


@pytest.mark.parametrize(("every", "told"), [(12, 4), (2, 0), (1, 0)])
def test_a_repeated_frame_is_told_where_others_differ(every: int, told: int) -> None:
    """A camera that gives each picture twice, or a still picture, is no fault of single frames."""
    check = FrameCheck(GLASS, 0 * GLASS, 8)
    blocks = 150 + np.random.default_rng(2).standard_normal((60, 8, 10))
    repeats = [k for k in range(1, 60) if k % every == 0]
    for k in repeats:
        blocks[k] = blocks[k - 1]
    status = [FRAME_STATUS[check.see(k, _blocks(blocks[k]), USABLE, 100, False)] for k in range(60)]
    assert [k for k in range(60) if status[k] == "repeated"] == (repeats if told else [])
    assert len(repeats) == told or not told
