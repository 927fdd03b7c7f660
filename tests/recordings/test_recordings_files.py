"""NumPy, HDF5, TIFF and image files."""

import cv2
import h5py
import numpy as np
import pytest
import tifffile

from fingerflow.errors import FingerflowError
from fingerflow.recordings import open_recording

RNG = np.random.default_rng(11)
GREY8 = RNG.integers(0, 256, (7, 20, 30)).astype(np.uint8)
GREY16 = RNG.integers(0, 65536, (7, 20, 30)).astype(np.uint16)
FLOAT = RNG.normal(size=(7, 20, 30)).astype(np.float32)
KINDS = [pytest.param(GREY8, 8, id="8"), pytest.param(GREY16, 16, id="16"), pytest.param(FLOAT, None, id="float")]


# NumPy


@pytest.mark.parametrize(("frames", "bits"), KINDS)
def test_npy(tmp_path, frames, bits):
    for number, version in enumerate(
        (frames, np.asfortranarray(frames), frames.astype(frames.dtype.newbyteorder(">")))
    ):
        np.save(tmp_path / f"{number}.npy", version)
        recording = open_recording(tmp_path / f"{number}.npy")
        np.testing.assert_array_equal(recording.read(), frames)
        assert (recording.dtype, recording.bit_depth) == (frames.dtype, bits)
        assert recording[0].dtype.isnative


def test_npy_of_one_frame(tmp_path):
    for number, frame in enumerate((GREY16[0], np.asfortranarray(GREY16[0]))):
        np.save(tmp_path / f"{number}.npy", frame)
        np.testing.assert_array_equal(open_recording(tmp_path / f"{number}.npy").read(), GREY16[:1])


def test_npy_truncated(tmp_path):
    np.save(tmp_path / "a.npy", GREY16)
    data = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(data[: -2 * 20 * 30 - 1])
    recording = open_recording(tmp_path / "a.npy")
    np.testing.assert_array_equal(recording.read(), GREY16[:5])
    assert recording.warnings == ("truncated: 2 of 7 frames are missing at the end of the file",)
    (tmp_path / "a.npy").write_bytes(data[:200])
    with pytest.raises(FingerflowError, match="too few"):
        open_recording(tmp_path / "a.npy")


@pytest.mark.parametrize(
    ("array", "named"),
    [
        (np.zeros((2, 3, 4, 3), np.uint8), "Colour"),
        (np.zeros(5, np.uint8), r"\(5,\)"),
        (np.zeros((2, 3, 4), np.int16), "int16"),
        (np.zeros((2, 3, 4), bool), "bool"),
        (np.zeros((0, 3, 4), np.uint8), "0, 3, 4"),
        (np.array([{}, None], object), "object"),
    ],
)
def test_npy_refused(tmp_path, array, named):
    np.save(tmp_path / "a.npy", array, allow_pickle=True)
    with pytest.raises(FingerflowError, match=named):
        open_recording(tmp_path / "a.npy")


# HDF5


@pytest.mark.parametrize(("frames", "bits"), KINDS)
def test_hdf5(tmp_path, frames, bits):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("trial/frames", data=frames, chunks=(3, 20, 30), compression="gzip")
        file["trial/force"] = np.zeros(100)
    with open_recording(tmp_path / "a.h5") as recording:
        np.testing.assert_array_equal(recording[::-1].read(), frames[::-1])
        assert (recording.dtype, recording.bit_depth, recording.frame_rate) == (frames.dtype, bits, None)


@pytest.mark.parametrize("holder", ["/", "/trial", "/trial/frames"])
def test_hdf5_attributes_of_the_data_set_or_around_it(tmp_path, holder):
    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        file["trial/frames"] = GREY16 >> 4
        file[holder].attrs["frame_rate"] = 300.0
        file[holder].attrs["bit_depth"] = np.array([12])
    recording = open_recording(tmp_path / "a.hdf5")
    assert (recording.frame_rate, recording.bit_depth) == (300, 12)
    assert recording.times[3] == pytest.approx(0.01)
    assert open_recording(tmp_path / "a.hdf5", frame_rate=60).frame_rate == 60


def test_hdf5_with_a_choice(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["left"] = GREY8
        file["right"] = GREY16
    with pytest.raises(FingerflowError, match=r"/left, /right.*a\.h5::/left"):
        open_recording(tmp_path / "a.h5")
    np.testing.assert_array_equal(open_recording(f"{tmp_path / 'a.h5'}::/right").read(), GREY16)
    np.testing.assert_array_equal(open_recording(f"{tmp_path / 'a.h5'}::left").read(), GREY8)
    with pytest.raises(FingerflowError, match=r"'/top'.*/left \(7, 20, 30\) uint8"):
        open_recording(f"{tmp_path / 'a.h5'}::/top")


@pytest.mark.parametrize(
    ("data", "attributes", "named"),
    [
        (np.zeros(9), {}, r"/x \(9,\)"),
        (np.zeros((2, 4, 4, 3), np.uint8), {}, "Colour"),
        (np.zeros((2, 4, 4), np.int32), {}, "int32"),
        (GREY8, {"frame_rate": -1.0}, "frame_rate is -1"),
        (GREY8, {"bit_depth": 12}, "bit_depth is 12"),
    ],
)
def test_hdf5_refused(tmp_path, data, attributes, named):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = data
        file["x"].attrs.update(attributes)
    with pytest.raises(FingerflowError, match=named):
        open_recording(tmp_path / "a.h5")


def test_hdf5_truncated(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = GREY16
    data = (tmp_path / "a.h5").read_bytes()
    (tmp_path / "a.h5").write_bytes(data[: len(data) // 2])
    with pytest.raises(FingerflowError, match="damaged"):
        open_recording(tmp_path / "a.h5")


# TIFF


@pytest.mark.parametrize(("frames", "bits"), KINDS)
@pytest.mark.parametrize(
    "options",
    [{}, {"imagej": True, "metadata": {"axes": "TYX"}}, {"bigtiff": True}, {"compression": "zlib"}, {"byteorder": ">"},
     {"rowsperstrip": 7}, {"tile": (16, 16)}],
    ids=str,
)  # fmt: skip
def test_tiff(tmp_path, frames, bits, options):
    tifffile.imwrite(tmp_path / "a.tif", frames, photometric="minisblack", **options)
    with open_recording(tmp_path / "a.tif") as recording:
        np.testing.assert_array_equal(recording.read(), frames)
        np.testing.assert_array_equal(recording.mapped(), frames)
        np.testing.assert_array_equal(recording[[5, 0]].read(), frames[[5, 0]])
        assert (recording.dtype, recording.bit_depth, recording.frame_rate) == (frames.dtype, bits, None)
        assert recording[0].dtype.isnative
        assert recording.warnings == ()


def test_tiff_written_page_by_page(tmp_path):
    with tifffile.TiffWriter(tmp_path / "a.tiff") as writer:
        for frame in GREY16:
            writer.write(frame, photometric="minisblack", metadata=None, contiguous=False)
    np.testing.assert_array_equal(open_recording(tmp_path / "a.tiff")[::-2].read(), GREY16[::-2])


def test_tiff_of_one_page(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", GREY8[0])
    np.testing.assert_array_equal(open_recording(tmp_path / "a.tif").read(), GREY8[:1])


@pytest.mark.parametrize(("unit", "seconds"), [("sec", 1), ("ms", 1e-3)])
def test_tiff_interval_of_imagej(tmp_path, unit, seconds):
    metadata = {"axes": "TYX", "finterval": 0.004 / seconds, "tunit": unit, "fps": 10.0}
    tifffile.imwrite(tmp_path / "a.tif", GREY8, imagej=True, metadata=metadata)
    recording = open_recording(tmp_path / "a.tif")
    assert recording.frame_rate == pytest.approx(250)
    assert recording.times[2] == pytest.approx(0.008)


def test_tiff_bit_depth_is_the_tag(tmp_path):
    frames = GREY16[0, :, :] >> 4
    # 12 bits a sample, packed by rows: written by hand, since the library writes whole bytes only.
    rows = b"".join(_pack12(row) for row in frames)
    (tmp_path / "a.tif").write_bytes(_baseline_tiff(30, 20, 12, rows))
    recording = open_recording(tmp_path / "a.tif")
    assert recording.bit_depth == 12
    np.testing.assert_array_equal(recording[0], frames)


@pytest.mark.parametrize("imagej", [True, False])
def test_tiff_truncated(tmp_path, imagej):
    tifffile.imwrite(tmp_path / "a.tif", GREY16, photometric="minisblack", imagej=imagej, byteorder="<")
    data = (tmp_path / "a.tif").read_bytes()
    at = data.index(GREY16[0].astype("<u2").tobytes())
    (tmp_path / "a.tif").write_bytes(data[: at + 1200 * 4 + 7])
    recording = open_recording(tmp_path / "a.tif")
    np.testing.assert_array_equal(recording.read(), GREY16[:4])
    assert recording.warnings[0].startswith("truncated")


def test_tiff_truncated_between_scattered_pages(tmp_path):
    with tifffile.TiffWriter(tmp_path / "a.tif") as writer:
        for frame in GREY16:
            writer.write(frame, photometric="minisblack", metadata=None, contiguous=False, compression="zlib")
    data = (tmp_path / "a.tif").read_bytes()
    (tmp_path / "a.tif").write_bytes(data[: int(len(data) * 0.6)])
    recording = open_recording(tmp_path / "a.tif")
    assert 1 <= len(recording) < 6
    np.testing.assert_array_equal(recording.read(), GREY16[: len(recording)])
    assert recording.warnings[0].startswith("truncated")


def test_tiff_refused(tmp_path):
    cases = {
        "colour": (np.zeros((5, 8, 9, 3), np.uint8), {"photometric": "rgb"}),
        "int16": (np.zeros((5, 8, 9), np.int16), {"photometric": "minisblack"}),
        "axes": (np.zeros((3, 5, 8, 9), np.uint8), {"imagej": True, "metadata": {"axes": "TZYX"}}),
    }
    for named, (array, options) in cases.items():
        tifffile.imwrite(tmp_path / "a.tif", array, **options)
        with pytest.raises(FingerflowError, match=named):
            open_recording(tmp_path / "a.tif")
    with tifffile.TiffWriter(tmp_path / "a.tif") as writer:
        writer.write(np.zeros((8, 9), np.uint8))
        writer.write(np.zeros((8, 10), np.uint8))
    with pytest.raises(FingerflowError, match="differ"):
        open_recording(tmp_path / "a.tif")


def test_tiff_whose_frames_are_called_channels(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", GREY8, imagej=True, metadata={"axes": "CYX"})
    recording = open_recording(tmp_path / "a.tif")
    np.testing.assert_array_equal(recording.read(), GREY8)
    assert "channels" in recording.warnings[0]


def test_tiff_with_white_at_zero_is_kept_and_named(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", GREY8, photometric="miniswhite")
    recording = open_recording(tmp_path / "a.tif")
    np.testing.assert_array_equal(recording.read(), GREY8)
    assert "white" in recording.warnings[0]


def _pack12(row: np.ndarray) -> bytes:
    first, second = row[0::2].astype(int), row[1::2].astype(int)
    triples = np.stack([first >> 4, (first & 15) << 4 | second >> 8, second & 255], 1)
    return triples.astype(np.uint8).tobytes()


def _baseline_tiff(width: int, height: int, bits: int, data: bytes) -> bytes:
    tags = [(256, 3, width), (257, 3, height), (258, 3, bits), (259, 3, 1), (262, 3, 1), (273, 4, 8), (277, 3, 1),
            (278, 3, height), (279, 4, len(data))]  # fmt: skip
    directory = len(tags).to_bytes(2, "little")
    for tag, kind, value in tags:
        directory += tag.to_bytes(2, "little") + kind.to_bytes(2, "little") + (1).to_bytes(4, "little")
        directory += value.to_bytes(4, "little")
    return b"II*\0" + (8 + len(data)).to_bytes(4, "little") + data + directory + bytes(4)


# Images


@pytest.mark.parametrize(("suffix", "frames"), [("png", GREY8), ("png", GREY16), ("bmp", GREY8), ("tif", GREY16)])
def test_folder_in_natural_order(tmp_path, suffix, frames):
    for number, frame in zip((1, 2, 3, 10, 11, 20, 100), frames, strict=True):
        cv2.imwrite(str(tmp_path / f"frame_{number}.{suffix}"), frame)
    (tmp_path / "notes.txt").write_text("not a frame")
    recording = open_recording(tmp_path, frame_rate=300)
    np.testing.assert_array_equal(recording.read(), frames)
    assert recording.bit_depth == 8 * frames.itemsize
    assert recording.metadata == {"first_file": f"frame_1.{suffix}", "last_file": f"frame_100.{suffix}"}


def test_natural_order_of_names_that_mix_words_and_numbers(tmp_path):
    names = ["a.png", "a1b2.png", "a1b10.png", "a02.png", "a10.png", "b.png", "10.png", "9.png"]
    for name in names:
        cv2.imwrite(str(tmp_path / name), GREY8[0])
    recording = open_recording(tmp_path)
    order = [file.name for file in recording._files]
    for before, after in (
        ("a1b2.png", "a1b10.png"),
        ("a02.png", "a10.png"),
        ("9.png", "10.png"),
        ("a1b2.png", "b.png"),
    ):
        assert order.index(before) < order.index(after)


@pytest.mark.parametrize("suffix", ["png", "bmp", "tif", "jpg"])
def test_one_image_is_a_recording_of_one_frame(tmp_path, suffix):
    ramp = np.broadcast_to(np.linspace(0, 255, 64).astype(np.uint8), (48, 64))
    path = tmp_path / f"éclairage.{suffix}"
    path.write_bytes(cv2.imencode(f".{suffix}", ramp)[1].tobytes())
    recording = open_recording(path)
    assert (len(recording), recording.frame_shape) == (1, (48, 64))
    assert np.abs(recording[0].astype(int) - ramp).max() <= (3 if suffix == "jpg" else 0)  # JPEG loses a little


def test_grey_in_three_equal_channels_is_kept(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.repeat(GREY16[0][..., None], 3, 2))
    np.testing.assert_array_equal(open_recording(tmp_path / "a.png")[0], GREY16[0])
    opaque = np.dstack([GREY8[0]] * 3 + [np.full_like(GREY8[0], 255)])
    cv2.imwrite(str(tmp_path / "b.png"), opaque)
    np.testing.assert_array_equal(open_recording(tmp_path / "b.png")[0], GREY8[0])


def test_colour_and_transparency_are_refused(tmp_path):
    colour = np.repeat(GREY8[0][..., None], 3, 2)
    colour[3, 4, 2] ^= 1
    cv2.imwrite(str(tmp_path / "a.png"), colour)
    with pytest.raises(FingerflowError, match=r"a\.png: has real colour"):
        open_recording(tmp_path / "a.png")
    cv2.imwrite(str(tmp_path / "a.png"), np.dstack([GREY8[0]] * 4))
    with pytest.raises(FingerflowError, match="transparency"):
        open_recording(tmp_path / "a.png")


def test_folders_that_are_no_recording(tmp_path):
    with pytest.raises(FingerflowError, match="no images"):
        open_recording(tmp_path)
    cv2.imwrite(str(tmp_path / "1.png"), GREY8[0])
    cv2.imwrite(str(tmp_path / "2.bmp"), GREY8[0])
    with pytest.raises(FingerflowError, match=r"1 \.bmp, 1 \.png"):
        open_recording(tmp_path)


def test_image_of_another_size_is_named_when_it_is_read(tmp_path):
    cv2.imwrite(str(tmp_path / "1.png"), GREY8[0])
    cv2.imwrite(str(tmp_path / "2.png"), GREY8[1, :10])
    recording = open_recording(tmp_path)
    np.testing.assert_array_equal(recording[0], GREY8[0])
    with pytest.raises(FingerflowError, match=r"2\.png: is 10 x 30 uint8.*1\.png, is 20 x 30"):
        recording.read()


def test_real_images(shared_data):
    empty = open_recording(shared_data / "rig" / "empty.jpg")
    assert (len(empty), empty.frame_shape, empty.bit_depth) == (1, (512, 1280), 8)
    folder = open_recording(shared_data / "rig")
    assert len(folder) == 3
    np.testing.assert_array_equal(folder[0], empty[0])
    speckle = open_recording(shared_data / "dic" / "sample14" / "reference.tif")
    assert speckle.read().shape == (1, 589, 2048)
