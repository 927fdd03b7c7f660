import numpy as np
import pytest

from fingerflow.synthetic import Camera, Press, Slide, SyntheticScene

ANY_SCENE = pytest.mark.parametrize("kind", [Press, Slide])


@ANY_SCENE
def test_frames_are_the_same_in_any_order(kind: type[SyntheticScene]) -> None:
    scene, again = kind(), kind()
    first = scene.render(200)
    assert first.shape == (512, 1280)
    assert first.dtype == np.uint8
    other = again.render(201)
    np.testing.assert_array_equal(again.render(200), first)
    assert (other != first).mean() > 0.5
    assert (kind(camera=Camera(seed=1)).render(200) != first).mean() > 0.5


@ANY_SCENE
def test_times_count_from_the_trigger(kind: type[SyntheticScene]) -> None:
    scene = kind(n_frames=40, frame_rate=100.0, frames_before_trigger=5)
    assert scene.times[[0, 5, 39]] == pytest.approx([-0.05, 0.0, 0.34])
    assert (np.diff(scene.progress(scene.times)) >= 0).all()
    time, _, _, trigger = scene.forces()
    assert np.diff(time) == pytest.approx(1e-4)
    assert time[0] <= scene.times[0]
    assert time[-1] >= scene.times[-1]
    assert time[np.flatnonzero(np.diff(trigger)) + 1] == pytest.approx([0.0], abs=1e-12)
    assert set(trigger) == {0.0, 5.0}
