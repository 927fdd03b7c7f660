"""Tests of the evaluation of frames in threads."""

import time
from collections.abc import Callable
from contextlib import closing

import pytest
import torch

from fingerflow.synthetic.frame_threads import each_frame


@pytest.mark.parametrize("frames", [[], [5], [3, 1, 2], list(range(40))], ids=len)
def test_values_come_in_the_order_of_frames(frames: list[int], torch_threads: Callable[[int], None]) -> None:
    torch_threads(3)
    threads = list(each_frame(lambda frame: (frame, torch.get_num_threads()), frames))
    assert threads == [(frame, 1) for frame in frames]
    assert torch.get_num_threads() == 3


@pytest.mark.parametrize("broken", [True, False], ids=["an error", "closed early"])
def test_the_rest_is_left_out(broken: bool, torch_threads: Callable[[int], None]) -> None:
    torch_threads(2)
    evaluated = []

    def evaluate(frame: int) -> int:
        evaluated.append(frame)
        if broken and frame == 2:
            raise KeyboardInterrupt
        time.sleep(0.01)
        return frame

    with closing(each_frame(evaluate, range(1000))) as values:  # ten seconds in all
        if broken:
            with pytest.raises(KeyboardInterrupt):
                list(values)
        else:
            assert next(values) == 0
    assert len(evaluated) < 1000
    assert torch.get_num_threads() == 2
