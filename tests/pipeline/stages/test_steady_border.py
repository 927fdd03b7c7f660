"""Tests of contact borders smoothed over time: exact for even growth, more precise than single frames otherwise."""

import numpy as np

from fingerflow.kernels.result_records import FrameEllipse
from fingerflow.pipeline.stages.strain.steady_border import steady_border

FRAMES = np.arange(60)
TIMES = FRAMES / 60


def growing(frames: int = 60) -> FrameEllipse:
    """Return an ellipse whose squared axes and centre are quadratic in time until growth stops at frame 40."""
    time = np.minimum(np.arange(frames) / 40, 1)
    squares = (2 * time - time**2)[:, None] * np.array([36.0, 20.0]) + np.array([0.3, 0.2])
    return FrameEllipse(np.outer(time - time**2 / 2, [0.3, -0.2]), np.sqrt(squares), np.full(frames, 0.4))


def test_an_evenly_growing_contact_is_kept() -> None:
    """Even growth is reproduced exactly up to 0.1 s before growth ends; there the fit over 13 frames sees half of the
    curvature, an error of 3 um.
    """
    given = growing()
    for one, other in zip(steady_border(given, TIMES), given, strict=True):
        np.testing.assert_allclose(one[:34], other[:34], atol=1e-9)
        np.testing.assert_allclose(one, other, atol=5e-3)


def test_frames_of_other_contacts_do_not_count() -> None:
    """Frames of another contact do not count: a finger put down 1 cm away, or a far larger contact in the
    next frame.
    """
    given = growing()
    moved = given._replace(center=given.center + np.where(FRAMES >= 50, 10.0, 0.0)[:, None])
    larger = given._replace(semi_axes=given.semi_axes + np.where(FRAMES >= 50, 3.0, 0.0)[:, None])
    for other in (moved, larger):
        found = steady_border(other, TIMES)
        np.testing.assert_allclose(found.semi_axes[:50], steady_border(growing(50), TIMES[:50]).semi_axes, atol=1e-6)
        np.testing.assert_allclose(found.semi_axes[50:], other.semi_axes[50:], atol=1e-9)


def test_a_border_that_stops_between_two_frames_is_followed() -> None:
    """The smoothed border errs by 10 um at most where it stops, after it has grown by 0.25 mm a frame; a fitted
    parabola errs by 40 um there.
    """
    radius = np.minimum(1 + 0.25 * np.arange(20), 3.9)[:, None] * np.ones(2)
    found = steady_border(FrameEllipse(0 * radius, radius, np.zeros(20)), np.arange(20) / 30)
    np.testing.assert_allclose(found.semi_axes, radius, atol=0.01)
