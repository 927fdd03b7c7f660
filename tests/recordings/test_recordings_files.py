"""Tests of NumPy, HDF5, TIFF and image files."""

import cv2
import h5py
import numpy as np
import pytest
import tifffile

from fingerflow.errors import FingerflowError
from fingerflow.recordings import open_recording
from tests.recordings.camera_files import pack_bits

RNG = np.random.default_rng(11)
GREY8 = RNG.integers(0, 256, (7, 20, 30)).astype(np.uint8)
GREY16 = RNG.integers(0, 65536, (7, 20, 30)).astype(np.uint16)
FLOAT = RNG.normal(size=(7, 20, 30)).astype(np.float32)
GREY = {"photometric": "minisblack"}
PAGES = GREY | {"metadata": None, "contiguous": False}


def write(path, frames, attributes=(), **options):
    """Write frames in the format of the suffix, with `attributes` of HDF5 and `options` of its library; TIFF page by
    page if not contiguous.
    """
    if path.suffix == ".npy":
        np.save(path, frames, **options)
    elif path.suffix == ".h5":
        with h5py.File(path, "w") as file:
            file.create_dataset("trial/frames", data=frames, **options).attrs.update(dict(attributes))
            file["trial/force"] = np.zeros(100)
    else:
        with tifffile.TiffWriter(path, bigtiff=options.pop("bigtiff", False), byteorder=options.pop("byteorder", None),
                                 imagej=options.pop("imagej", False)) as file:  # fmt: skip
            for part in (frames,) if options.get("contiguous", True) else frames:
                file.write(part, **options)
    return path


@pytest.mark.parametrize(
    ("name", "frames", "stored", "options"),
    [
        ("a.npy", FLOAT, np.ascontiguousarray, {}),
        ("a.npy", GREY8, np.asfortranarray, {}),
        ("a.npy", GREY16, lambda frames: frames.astype(frames.dtype.newbyteorder(">")), {}),
        ("a.npy", GREY16[:1], lambda frames: frames[0], {}),
        ("a.h5", GREY16, np.asarray, {"chunks": (3, 20, 30), "compression": "gzip"}),
        ("a.h5", FLOAT, np.asarray, {}),
        ("a.tif", FLOAT, np.asarray, GREY),
        ("a.tif", GREY16, np.asarray, GREY | {"imagej": True, "metadata": {"axes": "TYX"}}),
        ("a.tif", GREY8, np.asarray, GREY | {"bigtiff": True}),
        ("a.tif", GREY16, np.asarray, GREY | {"compression": "zlib"}),
        ("a.tif", GREY16, np.asarray, GREY | {"byteorder": ">"}),
        ("a.tif", GREY16, np.asarray, GREY | {"rowsperstrip": 7}),
        ("a.tif", GREY8, np.asarray, GREY | {"tile": (16, 16)}),
        ("a.tiff", GREY16, np.asarray, PAGES),
        ("a.tif", GREY8, np.asarray, GREY | {"contiguous": False}),  # each page is its own series
    ],
)
def test_frames_are_those_in_the_file(tmp_path, name, frames, stored, options):
    with open_recording(write(tmp_path / name, stored(frames), **options)) as recording:
        np.testing.assert_array_equal(recording.read(), frames)
        np.testing.assert_array_equal(recording.mapped(), frames)
        np.testing.assert_array_equal(recording[[-1, 0]].read(), frames[[-1, 0]])
        bits = None if frames is FLOAT else 8 * frames.itemsize
        assert (recording.dtype, recording.bit_depth, recording.frame_rate) == (frames.dtype, bits, None)
        assert recording[0].dtype.isnative
        assert recording.warnings == ()


@pytest.mark.parametrize(
    ("name", "options"), [("a.npy", {}), ("a.tif", GREY), ("a.tif", GREY | {"imagej": True, "byteorder": "<"})]
)
def test_a_truncated_file_has_its_whole_frames(tmp_path, name, options):
    data = write(tmp_path / name, GREY16, **options).read_bytes()
    (tmp_path / name).write_bytes(data[: data.index(GREY16[0].astype("<u2").tobytes()) + 1200 * 4 + 7])
    recording = open_recording(tmp_path / name)
    np.testing.assert_array_equal(recording.read(), GREY16[:4])
    assert recording.warnings[0].startswith("truncated")
    assert name != "a.npy" or recording.warnings[0] == "truncated: 3 of 7 frames are missing at the end of the file"


@pytest.mark.parametrize(
    ("name", "array", "options", "named"),
    [
        ("a.npy", np.zeros((2, 3, 4, 3), np.uint8), {}, "Colour"),
        ("a.h5", np.zeros(9), {}, r"/trial/frames \(9,\)"),
        ("a.h5", np.zeros((2, 4, 4, 3), np.uint8), {}, "Colour"),
        ("a.h5", GREY8, {"attributes": {"bit_depth": 12}}, "bit_depth is 12"),
        ("a.h5", GREY8, {"attributes": {"bit_depth": "many"}}, "bit_depth of /trial/frames .*should be one number"),
        ("a.tif", np.zeros((3, 5, 8, 9), np.uint8), {"imagej": True, "metadata": {"axes": "TZYX"}}, "axes"),
        ("a.tif", [np.zeros((8, 9), np.uint8), np.zeros((8, 10), np.uint8)], {"contiguous": False}, "differ"),
    ],
)
def test_what_is_no_stack_of_grey_frames_is_refused(tmp_path, name, array, options, named):
    with pytest.raises(FingerflowError, match=named):
        open_recording(write(tmp_path / name, array, **options))


# HDF5


@pytest.mark.parametrize("holder", ["/", "/trial", "/trial/frames"])
def test_hdf5_attributes_of_the_data_set_or_around_it(tmp_path, holder):
    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        file["trial/frames"] = GREY16 >> 4
        file[holder].attrs["frame_rate"] = 300.0
        file[holder].attrs["bit_depth"] = np.array([12])
    recording = open_recording(tmp_path / "a.hdf5")
    assert (recording.frame_rate, recording.bit_depth) == (300, 12)
    assert recording.times[3] == pytest.approx(0.01)
    other = open_recording(tmp_path / "a.hdf5", frame_rate=60)
    assert other.frame_rate == 60
    assert "states 300 Hz, and frame_rate = 60 is taken" in other.warnings[-1]


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


# TIFF


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_tiff_bit_depth_is_the_tag(tmp_path, bits):
    frames = GREY16[0, :, :] >> (16 - bits)
    # Samples are packed by rows; the library can only write whole bytes.
    rows = b"".join(pack_bits(row, bits) for row in frames)
    (tmp_path / "a.tif").write_bytes(_baseline_tiff(30, 20, bits, rows))
    recording = open_recording(tmp_path / "a.tif")
    assert (recording.bit_depth, recording.warnings) == (bits, ())
    np.testing.assert_array_equal(recording[0], frames)


@pytest.mark.parametrize(
    ("options", "said"),
    [({"imagej": True, "metadata": {"axes": "CYX"}}, "channels"), ({"photometric": "miniswhite"}, "white")],
)
def test_tiff_read_otherwise_than_declared_is_said(tmp_path, options, said):
    recording = open_recording(write(tmp_path / "a.tif", GREY8, **options))
    np.testing.assert_array_equal(recording.read(), GREY8)
    assert said in recording.warnings[0]


def _baseline_tiff(width: int, height: int, bits: int, data: bytes) -> bytes:
    tags = [(256, 3, width), (257, 3, height), (258, 3, bits), (259, 3, 1), (262, 3, 1), (273, 4, 8), (277, 3, 1),
            (278, 3, height), (279, 4, len(data))]  # fmt: skip
    directory = len(tags).to_bytes(2, "little")
    for tag, kind, value in tags:
        directory += tag.to_bytes(2, "little") + kind.to_bytes(2, "little") + (1).to_bytes(4, "little")
        directory += value.to_bytes(4, "little")
    return b"II*\0" + (8 + len(data)).to_bytes(4, "little") + data + directory + bytes(4)


# Images


@pytest.mark.parametrize(("suffix", "frames"), [("png", GREY16), ("bmp", GREY8), ("tif", GREY16)])
def test_folder_in_natural_order(tmp_path, suffix, frames):
    for number, frame in zip((1, 2, 3, 10, 11, 20, 100), frames, strict=True):
        cv2.imwrite(str(tmp_path / f"frame_{number}.{suffix}"), frame)
    (tmp_path / "notes.txt").write_text("not a frame")
    recording = open_recording(tmp_path, frame_rate=300)
    np.testing.assert_array_equal(recording.read(), frames)
    assert recording.bit_depth == 8 * frames.itemsize
    assert recording.metadata == {"first_file": f"frame_1.{suffix}", "last_file": f"frame_100.{suffix}"}


@pytest.mark.parametrize("suffix", ["png", "bmp", "tif", "jpg"])
def test_one_image_is_a_recording_of_one_frame(tmp_path, suffix):
    ramp = np.broadcast_to(np.linspace(0, 255, 64).astype(np.uint8), (48, 64))
    path = tmp_path / f"éclairage.{suffix}"
    path.write_bytes(cv2.imencode(f".{suffix}", ramp)[1].tobytes())
    recording = open_recording(path)
    assert (len(recording), recording.frame_shape) == (1, (48, 64))
    assert np.abs(recording[0].astype(int) - ramp).max() <= (3 if suffix == "jpg" else 0)  # JPEG is lossy


def test_grey_in_three_equal_channels_is_kept(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.repeat(GREY16[0][..., None], 3, 2))
    np.testing.assert_array_equal(open_recording(tmp_path / "a.png")[0], GREY16[0])
    cv2.imwrite(str(tmp_path / "b.png"), np.dstack([GREY8[0]] * 3 + [np.full_like(GREY8[0], 255)]))
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
