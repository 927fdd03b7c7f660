"""Tests of a folder of pictures as the source of a stream and as its background."""

import numpy as np
import pytest
from tiny_bundle import HEIGHT, WIDTH, Stream, frame, write_bundle

cv2 = pytest.importorskip("cv2")


def test_pictures_are_played_in_the_order_of_their_numbers(stream: Stream) -> None:
    folder = stream.folder / "press"
    folder.mkdir()
    for number in range(12):
        picture = frame(contact_px=number)
        cv2.imwrite(str(folder / f"frame{number}.png"), picture if number % 2 else np.stack([picture] * 3, -1))
    (folder / "notes.txt").write_text("not a picture")
    (stream.folder / "empty").mkdir()
    said = stream.refused("--source", str(stream.folder / "empty"))
    assert "empty: the folder has no images (.png, .jpg" in said
    ended = stream.run("--source", str(folder))
    np.testing.assert_array_equal(ended.results.records["real_contact_area"], np.arange(12) / 4)
    np.testing.assert_array_equal(ended.results.records["frame"], np.arange(12))


def test_sixteen_bits_stay(stream: Stream) -> None:
    stream.bundle = write_bundle(stream.folder / "deep", bit_depth=12)
    stream.scene.rename(stream.bundle / "scene.toml")
    for name, level in (("press", 600), ("empty", 2000)):
        (stream.bundle / name).mkdir()
        cv2.imwrite(str(stream.bundle / name / "0.png"), np.full((HEIGHT, 2 * WIDTH), level, np.uint16))
    path = stream.bundle / "scene.toml"
    path.write_text(path.read_text().replace("empty.npy", "empty"))
    ended = stream.run("--source", str(stream.bundle / "press"))
    assert ended.results.records["real_contact_area"][0] == HEIGHT * WIDTH / 4
