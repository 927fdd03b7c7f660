"""Tests of Phantom `.cine` files: frames packed by the test, and real recordings."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fingerflow.errors import FingerflowError
from fingerflow.recordings import Recording, open_recording
from fingerflow.recordings.frames.cine import LINEAR_OF_COMPANDED
from tests.recordings.camera_files import Cine, pack_bits


def frames_of(bits: int, count: int = 5, shape: tuple[int, int] = (6, 10)) -> np.ndarray:
    frames = np.random.default_rng(7).integers(0, 2**bits, (count, *shape))
    frames[0].flat[:4] = [0, 2**bits - 1, 1, 2 ** (bits - 1)]
    return frames.astype(np.uint8 if bits == 8 else np.uint16)


def cine(frames: np.ndarray, **fields: Any) -> Cine:
    """Return an uncompressed recording of frames with the first row first, unless `fields` say otherwise."""
    bits = 8 * frames.itemsize
    pixels = [frame.astype(frame.dtype.newbyteorder("<")).tobytes() for frame in frames]
    setup = {"RealBPP": 8 if bits == 8 else 12} | fields.pop("setup", {})
    return Cine(**{"width": 10, "height": -6, "pixels": pixels, "bits": bits, "setup": setup} | fields)


def opened(folder: Path, content: Cine, **options: Any) -> Recording:
    return open_recording(content.write(folder / "a.cine"), **options)


@pytest.mark.parametrize(("bits", "height"), [(8, 6), (8, -6), (14, 6), (16, -6)])
def test_uncompressed_frames_have_the_last_row_first_unless_the_height_is_negative(tmp_path, bits, height):
    frames = frames_of(bits)
    in_file = frames[:, ::-1] if height > 0 else frames
    recording = opened(tmp_path, cine(in_file, height=height, setup={"RealBPP": bits, "bFlipV": 1}))
    np.testing.assert_array_equal(recording.read(), frames)
    assert (recording.dtype, recording.bit_depth) == (frames.dtype, bits)
    assert "bFlipV" in recording.warnings[0]  # meant for players, and not applied


@pytest.mark.parametrize("height", [6, -6])
def test_packed_12_bit_frames_have_the_first_row_first(tmp_path, height):
    frames = frames_of(12)
    packed = [pack_bits(frame, 12) for frame in frames]
    recording = opened(tmp_path, cine(frames, height=height, pixels=packed, packing=1024))
    np.testing.assert_array_equal(recording.read(), frames)
    assert (recording.dtype, recording.bit_depth) == (np.uint16, 12)


@pytest.mark.parametrize("shape", [(6, 10), (3, 7)], ids=["whole bytes", "a last group of one value"])
def test_packed_10_bit_frames_are_linearised_to_12_bits(tmp_path, shape):
    codes = frames_of(10, shape=shape)
    packed = [pack_bits(frame, 10) for frame in codes]
    levels = {"RealBPP": 10, "BlackLevel": 64, "WhiteLevel": 1014}
    content = cine(codes, width=shape[1], height=shape[0], pixels=packed, packing=256, setup=levels)
    recording = opened(tmp_path, content)
    np.testing.assert_array_equal(recording.read(), LINEAR_OF_COMPANDED[codes])
    assert recording.bit_depth == 12
    # The levels are stated for the codes; after linearisation they are 64 and 4064 of 4095.
    assert (recording.metadata["black_level"], recording.metadata["white_level"]) == (64, 4064)


def test_rows_filled_up_to_four_bytes(tmp_path):
    frames = frames_of(8, shape=(4, 6))
    padded = np.pad(frames, ((0, 0), (0, 0), (0, 2)), constant_values=99)
    np.testing.assert_array_equal(opened(tmp_path, cine(padded, width=6, height=-4)).read(), frames)


EVEN = (np.arange(5) - 2) / 300


@pytest.mark.parametrize(
    ("stamps", "stated", "rate", "times", "said"),
    [
        ([-0.0071, -0.0031, 0.0009, 0.0049, 0.0089], 250, 250, [-0.0071, -0.0031, 0.0009, 0.0049, 0.0089], []),
        (None, 300, 300, EVEN, []),  # the number of the first frame counts from the trigger
        (EVEN, 3000, 300, EVEN, ["3000 Hz", "300 Hz"]),  # every tenth frame was saved
        (EVEN - 9e5, 300, 300, EVEN, ["reset"]),
        ([0.0] * 5, 300, 300, EVEN, ["do not increase"]),
        ([-0.02, -0.01, 0, 0.04, 0.05], 100, 100, [-0.02, -0.01, 0, 0.04, 0.05], ["first of 3 frames after frame 2"]),
    ],
    ids=["stamps", "no stamps", "left out on saving", "reset clock", "no increase", "gap"],
)
def test_times_are_those_of_the_stamps_from_the_trigger(tmp_path, stamps, stated, rate, times, said):
    recording = opened(tmp_path, cine(frames_of(8), stamps=stamps, setup={"FrameRate": stated}))
    np.testing.assert_allclose(recording.times, times, atol=1e-9 if "reset" not in said else 1e-6)  # a stamp: 2^-30 s
    assert recording.frame_rate == pytest.approx(rate, rel=1e-6)
    assert len(recording.warnings) == bool(said)
    assert all(word in recording.warnings[0] for word in said)
    assert recording.metadata["serial"] == 4711
    assert stamps is None or recording.metadata["exposure_s"] == pytest.approx(0.001)


def test_a_given_frame_rate_replaces_the_stamps_and_keeps_the_trigger_in_place(tmp_path):
    recording = opened(tmp_path, cine(frames_of(8), stamps=list(EVEN)), frame_rate=1000)
    assert recording.frame_rate == 1000
    np.testing.assert_allclose(recording.times, (np.arange(5) - 2) / 1000, atol=1e-9)


def test_precise_rate_of_newer_cameras_and_short_setup_of_older_ones(tmp_path):
    new = opened(tmp_path, cine(frames_of(12), setup={"dFrameRate": 299.97, "CameraModel": b"Phantom T1340"}))
    assert (new.frame_rate, new.metadata["camera"]) == (299.97, "Phantom T1340")
    old = opened(tmp_path, cine(frames_of(12), setup_length=5692))
    assert old.frame_rate == 300
    assert "black_level" not in old.metadata


@pytest.mark.parametrize(("lost", "annotation", "left"), [(1, 0, 4), (121, 0, 4), (350, 0, 2), (200, 100, 4)])
def test_truncated_file_gives_the_frames_that_are_whole(tmp_path, lost, annotation, left):
    frames = frames_of(12)  # 120 bytes each, after 8 bytes or more with an annotation
    (tmp_path / "cut.cine").write_bytes(cine(frames, annotation=bytes(annotation)).bytes()[:-lost])
    recording = open_recording(tmp_path / "cut.cine")
    np.testing.assert_array_equal(recording.read(), frames[:left])
    assert recording.warnings[0].startswith(f"truncated: {5 - left} of 5 frames are missing")
    assert len(recording) == len(recording.times) == left


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"compression": 2}, "colour filter"),
        ({"bits": 24}, "24 bits"),
        ({"compression": 1}, "Compression 1"),
        ({"packing": 512}, "biCompression 512"),
        ({"packing": 256}, "biSizeImage"),
        ({"width": 11}, "11 x 6"),
    ],
)
def test_what_is_not_grey_or_not_known_is_refused_by_name(tmp_path, change, named):
    with pytest.raises(FingerflowError, match=named):
        opened(tmp_path, cine(frames_of(12), **change))


# Real recordings. The sums (first frame, its upper half) are those of the decoded images that the image-correlation
# program DICe ships for the same files; all pixels of all frames were compared once and are equal.
@pytest.mark.parametrize(
    ("name", "dtype", "bits", "rate", "start", "total", "upper_half"),
    [
        ("packed_12bpp", np.uint16, 12, 100, 0.606142, 17124325, 8766652),
        ("packed_raw_12bpp", np.uint16, 12, 100, 0.606142, 17124325, 8766652),
        ("phantom_v1610", np.uint8, 8, 100, -0.844701, 3682882, 1793240),
        ("phantom_v9_raw_16bpp", np.uint8, 8, 300, 4.247823, 1595766, 711804),
    ],
)
def test_real_recordings(shared_data, name, dtype, bits, rate, start, total, upper_half):
    recording = open_recording(shared_data / "cine" / f"{name}.cine")
    assert (len(recording), recording.frame_shape) == (6, (128, 256))
    assert (recording.dtype, recording.bit_depth, recording.frame_rate) == (np.dtype(dtype), bits, rate)
    assert recording.times[0] == pytest.approx(start, abs=1e-6)
    assert np.diff(recording.times) == pytest.approx(1 / rate, abs=2e-6)
    assert int(recording[0].sum(dtype=np.int64)) == total
    assert int(recording[0][:64].sum(dtype=np.int64)) == upper_half
    said = "791.463 s by its number 237439"  # of the clock and the numbers of frames, which disagree
    assert (said in "".join(recording.warnings)) == (name == "phantom_v9_raw_16bpp")
    with pytest.raises(FingerflowError, match="colour"):
        open_recording(shared_data / "cine" / "invalid_color.cine")
