"""Tests of skin from an image that is drawn from a formula, so that the true skin is known."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from fingerflow import synthetic
from fingerflow.errors import FingerflowError

DPI = 500.0
MM_PER_PX = 25.4 / DPI
SMALL = {"n_frames": 3, "frame_rate": 3.0, "frames_before_trigger": 0, "frame_shape": (200, 400)}


@pytest.fixture(scope="module")
def source() -> synthetic.FingerprintTexture:
    return synthetic.FingerprintTexture(pattern="whorl", centre=(7.0, 8.0))


@pytest.fixture(scope="module")
def picture(source: synthetic.FingerprintTexture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the image of a print of 14 x 16 mm under uneven light, with dark ridges in an ellipse on bright glass;
    return its path.
    """
    path: Path = tmp_path_factory.mktemp("print") / "finger.png"
    ridges = synthetic.texture_image(source.ridges, (315, 276), MM_PER_PX)[0, 0].numpy()
    row, column = np.mgrid[0:315, 0:276]
    inside = ((column - 138) / 125) ** 2 + ((row - 157) / 145) ** 2 < 1
    light = 200 - 0.1 * column - 0.05 * row
    cv2.imwrite(str(path), np.where(inside, light * (0.65 - 0.3 * ridges), light * 0.95).astype(np.uint8))
    return path


def test_ridges_of_the_picture_are_where_they_were(source: synthetic.FingerprintTexture, picture: Path) -> None:
    texture = synthetic.PictureTexture(picture, DPI, centre=(137.5 * MM_PER_PX, 157 * MM_PER_PX))
    y, x = torch.meshgrid(*(torch.arange(4.0, 10.0, 0.013, dtype=torch.float64),) * 2, indexing="ij")
    touching = texture.ridge_margin(x, y, 0.5, torch.full_like(x, 9.0)) > 0
    # Pixels of 0.05 mm blur the edges, 10 mm of which lie in each mm².
    assert (touching == (source.ridges(x, y) > 0)).double().mean() > 0.95
    contrast, ridges = texture(x, y), source.ridges(x, y)
    assert np.corrcoef(contrast.flatten(), ridges.flatten())[0, 1] > 0.95
    assert contrast.abs().max() <= 1


def test_recording_carries_its_picture(picture: Path, tmp_path: Path) -> None:
    """The truth is rebuilt from the recording alone, without the file of the image."""
    given = tmp_path / "given.png"
    given.write_bytes(picture.read_bytes())
    scene = synthetic.Press(**SMALL, texture=synthetic.PictureTexture(given, DPI), semi_axes=(2.0, 1.6))
    synthetic.write_recording(tmp_path / "press", scene)
    given.unlink()
    rebuilt = synthetic.rebuild_scene(tmp_path / "press")
    np.testing.assert_array_equal(rebuilt.render(2), np.load(tmp_path / "press" / "frames.npy")[2])
    assert rebuilt.truth.real_contact_area_mm2(2) == scene.truth.real_contact_area_mm2(2)


def test_wrong_pictures_are_refused_with_the_way_out(picture: Path, tmp_path: Path) -> None:
    def refused(name: str, message: str, image: np.ndarray | bytes | None = None, dpi: float = DPI) -> None:
        path = tmp_path / name if image is not None else picture
        if isinstance(image, bytes):
            path.write_bytes(image)
        elif image is not None:
            cv2.imwrite(str(path), image)
        with pytest.raises(FingerflowError, match=message):
            synthetic.scene_of_print(synthetic.Press, path, dpi)

    with pytest.raises(FingerflowError, match=r"none\.png does not exist; give a PNG, TIFF, BMP or JPEG"):
        synthetic.PictureTexture(tmp_path / "none.png")
    refused("text.png", r"text\.png cannot be read as a picture", b"no picture")
    refused("tiny.png", "has 30 x 500 pixels; 64 x 64 are the least", np.zeros((30, 500), np.uint8))
    refused("blank.png", "shows no ridges", np.full((300, 300), 90, np.uint8))
    refused("", r"ridges are 1\.\d\d mm apart at 200 dpi, those of skin 0\.25 to 0\.8 mm; give the picture's", dpi=200)
    refused("", "dpi is 3; a picture that shows ridges has 50 to 10,000", dpi=3)
    part = cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE)[60:240, 60:240]
    refused("part.png", r"shows 9\.1 x 9\.1 mm at 500 dpi, and the contact needs 1\d\.\d x \d\.\d mm of skin", part)
