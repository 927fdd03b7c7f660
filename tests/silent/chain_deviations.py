"""Errors divided by stated deviations, as in `deviations`, on the eight presses of a study of two people by
`fingerflow study simulate`, on more slippery glass: skin moves little over the glass there.
"""

from collections.abc import Iterator

from fingerflow.study.simulated_trials import Design, draw_presses, make_recording
from tests.silent.case import Case
from tests.silent.deviations import judged


def cases() -> Iterator[Case]:
    """Yield a case for each quantity, recorded and live."""
    design = Design(participants=2, trials=2, amplitudes=(3.0,), friction=(0.4, 0.15))
    yield from judged((f"press {k}", make_recording(design, draw_presses(design), k)) for k in range(8))
