"""Rigs in which contact appears bright: the same numbers as for dark contact, and warnings of the wrong setting."""

from pathlib import Path

import numpy as np
import pytest

from fingerflow import load_scene, process
from fingerflow.engines.engine import Array
from fingerflow.errors import FingerflowError
from tests.pipeline.stages.conftest import Change
from tests.small_trials import warnings_of

BRIGHT = {'appears = "dark"': 'appears = "bright"'}
WITHOUT_DARK = {"dark = ": "# dark = "}


@pytest.fixture
def pictures(press: Path) -> dict[str, Array]:
    return {name: np.load(press / f"{name}.npy") for name in ("frames", "empty")}


@pytest.fixture
def negatives(press: Path, pictures: dict[str, Array]) -> dict[str, Array]:
    """Return the pictures with the negative of their contact view."""
    view, negatives = load_scene(press / "scene.toml").views.contact, dict[str, Array]()
    for name, picture in pictures.items():
        negatives[name] = picture.copy()
        view.crop(negatives[name])[...] = 255 - view.crop(picture)
    return negatives


def test_the_negative_of_a_recording_gives_the_same_numbers(negatives: dict[str, Array], changed: Change) -> None:
    """The negative of a recording with `appears = "bright"` gives exactly the results of the recording itself."""
    dark_contact = process(changed(WITHOUT_DARK))
    bright_contact = process(changed(BRIGHT, **negatives))
    assert float(dark_contact["real_contact_area"].max()) > 1
    for name, values in dark_contact.data_vars.items():
        np.testing.assert_array_equal(bright_contact[name].values, values.values, err_msg=str(name))
    assert warnings_of(bright_contact) == warnings_of(dark_contact)
    for pixel in np.uint16(16), np.float32(1 / 255):  # of a camera of 12 bits, and of a program that scales to 1
        scaled = {name: picture.astype(pixel.dtype) * pixel for name, picture in negatives.items()}
        if pixel < 1:
            scaled["frames"][0] = np.inf  # this frame alone does not count
        area = process(changed(BRIGHT, **scaled), ["real_contact_area"])["real_contact_area"]
        np.testing.assert_allclose(area[1:], dark_contact["real_contact_area"][1:], rtol=0.01, atol=0.01)


def test_the_wrong_setting_is_named(pictures: dict[str, Array], negatives: dict[str, Array], changed: Change) -> None:
    """A recording with the other contrast is refused, and the refusal names the remedy."""
    for replaced, arrays, remedy in ((BRIGHT, pictures, "dark"), (WITHOUT_DARK, negatives, "bright")):
        with pytest.raises(
            FingerflowError, match=rf'no contact: at the largest force.* set contact\.appears = "{remedy}"'
        ):
            process(changed(replaced, **arrays), ["real_contact_area"])
