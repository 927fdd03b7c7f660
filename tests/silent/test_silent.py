"""Tests that no fault, mistake or setting gives a wrong result without a warning, by some cases of each group."""

import re
from importlib import import_module
from pathlib import Path

import pytest

from bench.prints import FINGERS
from fingerflow.kernels.library import is_present
from tests.silent.deviation_scenes import scenes
from tests.silent.deviations import judged
from tests.silent.mistakes import MISTAKES

TROUBLESHOOTING = Path(__file__).resolve().parents[2] / "docs" / "troubleshooting.md"
SAMPLE = ("press 3", "press 7", "slide 4")
#: Most RMS of error over deviation, and least share of the errors within two deviations, with room for other machines.
LIMITS = {
    "presses: displacement": (1.6, 0.85),
    "presses: divergence": (1.6, 0.85),
    "presses: curl": (1.7, 0.85),
    "presses: median_divergence": (1.6, 0.8),
    "presses: strain_energy": (1.6, 0.8),
    "slides: displacement": (3.0, 0.8),
    "slides: divergence": (2.0, 0.8),
    "slides: curl": (2.2, 0.8),
    "presses, live: median_divergence": (1.6, 0.8),
    "presses, live: divergence": (1.7, 0.85),
    "presses, live: curl": (1.7, 0.85),
    "slides, live: divergence": (2.0, 0.8),
}


@pytest.mark.long
@pytest.mark.parametrize("group", ["contact", "frames", "mistakes", "points", "settings", "slip_flag"])
def test_nothing_is_wrong_in_silence(group: str) -> None:
    if group == "slip_flag" and not is_present():
        pytest.skip("the compiled library was not built or is turned off")
    right = ("right", "warned", "refused", "told", "within deviations")
    assert [one for one in import_module(f"tests.silent.{group}").cases(few=True) if one.verdict not in right] == []


def test_the_page_shows_every_mistake() -> None:
    rows = {line.split(" | ")[0]: line for line in TROUBLESHOOTING.read_text(encoding="utf-8").splitlines()}
    assert len(MISTAKES) >= 40
    for mistake in MISTAKES:
        row = rows[f"| {mistake.what}"]
        assert not [word for word in mistake.words if word not in row], row


@pytest.mark.long
@pytest.mark.skipif(not FINGERS.is_dir(), reason="real prints are not here")
def test_deviations_hold_on_real_prints() -> None:
    found = {one.case: one for one in judged((name, scene) for name, scene in scenes() if name.startswith(SAMPLE))}
    off = []
    for name, (most, least) in LIMITS.items():
        if name not in found:  # no compiled library, no stream
            assert "live" in name
            continue
        spread, _, within = (float(one) for one in re.findall(r"[\d.]+", found[name].number))
        if spread > most or within < 100 * least:
            off.append(found[name])
    assert off == []
