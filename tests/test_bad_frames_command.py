"""`python -m tests.bad_frames` sees what is wrong; the command itself takes a quarter of an hour."""

import numpy as np

from tests import bad_frames
from tests.bad_frames import FRAME_NOT_USABLE, TRACKED, USABLE, Run

FRAMES, POINTS, BAD = 20, 5, 7
NAMES = ["median_divergence", "real_contact_area", "position_px"]


def _clean() -> Run:
    numbers = {
        "median_divergence": np.linspace(0, 0.1, FRAMES),
        "median_divergence_std": np.full(FRAMES, 1e-3),
        "real_contact_area": np.linspace(1, 20, FRAMES),
        "position_px": np.ones((FRAMES, POINTS, 2)),
        "position_std_px": np.full((FRAMES, POINTS), 0.02),
    }
    return Run(np.full(FRAMES, USABLE), np.full((FRAMES, POINTS), TRACKED), numbers)


def _found() -> Run:
    """A run in which the bad frame was found, and all else is as before."""
    run = _clean()
    run.status[BAD], run.of_point[BAD] = 3, FRAME_NOT_USABLE
    for name in NAMES:
        run.numbers[name][BAD] = np.nan
    return run


def _wrong(run: Run) -> int:
    return bad_frames._compare(_clean(), run, _clean(), np.array([BAD]), NAMES, 5e-3)[1]


def test_a_frame_that_was_found_is_no_fault() -> None:
    assert _wrong(_found()) == 0


def test_what_is_wrong_is_counted() -> None:
    far, area, missing, more, told = (_found() for _ in range(5))
    far.numbers["position_px"][9, 2, 0] += 0.2
    area.numbers["real_contact_area"][9] += 0.2
    missing.numbers["median_divergence"][9] = np.nan
    more.status[9] = 3
    told.numbers["real_contact_area"][BAD] = 3.0
    assert [_wrong(one) for one in (far, area, missing, more, told)] == [1] * 5
    unseen = _clean()
    unseen.numbers["real_contact_area"][BAD] *= 2
    assert _wrong(unseen) == 1


def test_one_place_in_each_tenth() -> None:
    places = bad_frames._places(300, 141, np.random.default_rng(3))
    assert (places // 30).tolist() == list(range(10))
    assert 141 in places
    assert np.diff(places).min() > 1
