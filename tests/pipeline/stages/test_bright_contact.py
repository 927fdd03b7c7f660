"""Rigs in which contact appears bright: the same numbers as for dark contact, and warnings of the wrong setting."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fingerflow import load_scene, process
from fingerflow.errors import FingerflowError
from tests.pipeline.stages.conftest import Change
from tests.small_trials import warnings_of

BRIGHT = {'appears = "dark"': 'appears = "bright"'}
WITHOUT_DARK = {"dark = ": "# dark = "}
Frames = np.ndarray[Any, Any]


@pytest.fixture
def pictures(press: Path) -> dict[str, Frames]:
    return {name: np.load(press / f"{name}.npy") for name in ("frames", "empty")}


def with_contact_view(press: Path, picture: Frames, contact: Frames) -> Frames:
    """Return frames whose contact view is replaced by another one of the same size."""
    view = load_scene(press / "scene.toml").views.contact
    result = picture.copy()
    view.crop(result)[...] = contact
    return result


def test_the_negative_of_a_recording_gives_the_same_numbers(
    press: Path, pictures: dict[str, Frames], changed: Change
) -> None:
    """The negative of a recording with `appears = "bright"` gives exactly the results of the recording itself."""
    dark_contact = process(changed(WITHOUT_DARK))
    view = load_scene(press / "scene.toml").views.contact
    negatives = {name: with_contact_view(press, one, 255 - view.crop(one)) for name, one in pictures.items()}
    bright_contact = process(changed(BRIGHT, **negatives))
    assert float(dark_contact["real_contact_area"].max()) > 1
    for name, values in dark_contact.data_vars.items():
        np.testing.assert_array_equal(bright_contact[name].values, values.values, err_msg=str(name))
    assert warnings_of(bright_contact) == warnings_of(dark_contact)


def frustrated_reflection(press: Path, pictures: dict[str, Frames]) -> dict[str, Frames]:
    """Return pictures of a rig whose glass is almost dark, 8 counts, and 140 counts brighter where all light of the
    original recording was lost.
    """
    view = load_scene(press / "scene.toml").views.contact
    dark, glass = view.crop(np.load(press / "dark.npy")), view.crop(pictures["empty"])
    light = glass - dark
    lit = light > 0.06 * light.max()
    lost = np.where(lit, 1 - (view.crop(pictures["frames"]) - dark) / np.where(lit, light, 1), 0)
    noise = np.random.default_rng(0).normal(0, 0.7, lost.shape)
    seen = np.rint(8 + 140 * lost.clip(0, 1) + noise).clip(0, 255)
    empty = np.rint(8 + np.random.default_rng(1).normal(0, 0.7, glass.shape)).clip(0, 255)
    return {
        "frames": with_contact_view(press, pictures["frames"], seen),
        "empty": with_contact_view(press, pictures["empty"], empty),
    }


def test_skin_that_lights_up_on_dark_glass(press: Path, pictures: dict[str, Frames], changed: Change) -> None:
    """Its areas are those of the recording with dark contact, within 2 %: the threshold is measured in each, and single
    pixels at the borders of ridges fall on either side of it.
    """
    names = ["real_contact_area", "gross_contact_area"]
    known = process(changed(), names)
    found = process(changed(BRIGHT, **frustrated_reflection(press, pictures)), names)
    for name in names:
        large = known[name].values > 1
        assert large.sum() >= 4
        np.testing.assert_allclose(found[name].values[large], known[name].values[large], rtol=0.02, err_msg=name)
    assert "contact.appears" not in warnings_of(found)


def test_the_wrong_setting_is_named(press: Path, pictures: dict[str, Frames], changed: Change) -> None:
    """A recording with the other contrast is refused, and the refusal names the remedy; floating-point frames have no
    negative.
    """
    cases = ((BRIGHT, pictures, "dark"), ({}, frustrated_reflection(press, pictures), "bright"))
    for replaced, arrays, remedy in cases:
        with pytest.raises(
            FingerflowError, match=rf'no contact: at the largest force.* set contact\.appears = "{remedy}"'
        ):
            process(changed(replaced, **arrays), ["real_contact_area"])
    floating = {name: one.astype(np.float32) for name, one in pictures.items()}
    with pytest.raises(FingerflowError, match=r'contact\.appears is "bright", and the frames are floating-point'):
        process(changed(BRIGHT, **floating), ["real_contact_area"])
