"""Phantom `.cine`: frames that the test packs itself, and real recordings."""

import numpy as np
import pytest

from fingerflow.errors import FingerflowError
from fingerflow.recordings import open_recording
from fingerflow.recordings.frames.cine_companding import LINEAR_OF_COMPANDED
from tests.recordings.camera_files import Cine, pack_bits


def frames_of(bits: int, count: int = 5, shape: tuple[int, int] = (6, 10)) -> np.ndarray:
    frames = np.random.default_rng(7).integers(0, 2**bits, (count, *shape))
    frames[0].flat[:4] = [0, 2**bits - 1, 1, 2 ** (bits - 1)]
    return frames.astype(np.uint8 if bits == 8 else np.uint16)


def plain(frame: np.ndarray) -> bytes:
    return frame.astype("<u2" if frame.dtype == np.uint16 else np.uint8).tobytes()


@pytest.mark.parametrize("bits", [8, 12, 14, 16])
@pytest.mark.parametrize("height_sign", [1, -1])
def test_uncompressed_frames_are_bitmaps_with_the_last_row_first_unless_the_height_is_negative(
    tmp_path, bits, height_sign
):
    frames = frames_of(bits)
    in_file = frames[:, ::-1] if height_sign > 0 else frames
    cine = Cine(
        10, 6 * height_sign, [plain(frame) for frame in in_file], 8 if bits == 8 else 16, setup={"RealBPP": bits}
    )
    recording = open_recording(cine.write(tmp_path / "a.cine"))
    np.testing.assert_array_equal(recording.read(), frames)
    assert recording.dtype == frames.dtype
    assert recording.bit_depth == bits
    assert recording.warnings == ()


@pytest.mark.parametrize("height_sign", [1, -1])
def test_packed_12_bit_frames_have_the_first_row_first(tmp_path, height_sign):
    frames = frames_of(12)
    cine = Cine(10, 6 * height_sign, [pack_bits(frame, 12) for frame in frames], packing=1024)
    recording = open_recording(cine.write(tmp_path / "a.cine"))
    np.testing.assert_array_equal(recording.read(), frames)
    assert recording.bit_depth == 12
    assert recording.dtype == np.uint16


@pytest.mark.parametrize("shape", [(6, 10), (3, 7)], ids=["whole bytes", "a last group of one value"])
def test_packed_10_bit_frames_are_linearised_to_12_bits(tmp_path, shape):
    codes = frames_of(10, shape=shape)
    cine = Cine(shape[1], shape[0], [pack_bits(frame, 10) for frame in codes], packing=256)
    cine.setup = {"RealBPP": 10, "BlackLevel": 64, "WhiteLevel": 1014}
    recording = open_recording(cine.write(tmp_path / "a.cine"))
    np.testing.assert_array_equal(recording.read(), LINEAR_OF_COMPANDED[codes])
    assert recording.bit_depth == 12
    # The levels are stated for the codes; after linearisation they are 64 and 4064 of 4095.
    assert (recording.metadata["black_level"], recording.metadata["white_level"]) == (64, 4064)


def test_the_companding_table_is_the_curve_of_bt_709():
    code = np.arange(1015.0)
    video = (code - 64) / (1014 - 64)
    # BT.709: V = 4.5 L below L = 0.018, else 1.099 L^0.45 - 0.099.
    light = np.where(video < 4.5 * 0.018, video / 4.5, ((np.maximum(video, 0) + 0.099) / 1.099) ** (1 / 0.45))
    difference = LINEAR_OF_COMPANDED[:1015] - (64 + 4000 * light)
    # Measured 2.43 of 4095: a quarter of the step between two codes at the bright end. A wrong entry would stand out.
    assert np.abs(difference[64:]).max() < 2.5
    assert LINEAR_OF_COMPANDED.shape == (1024,)
    assert np.all(np.diff(LINEAR_OF_COMPANDED.astype(int)) >= 0)
    assert (LINEAR_OF_COMPANDED[64], LINEAR_OF_COMPANDED[1014], LINEAR_OF_COMPANDED[1023]) == (64, 4064, 4095)


def test_rows_filled_up_to_four_bytes(tmp_path):
    frames = frames_of(8, shape=(4, 6))
    padded = np.pad(frames, ((0, 0), (0, 0), (0, 2)), constant_values=99)[:, ::-1]
    cine = Cine(6, 4, [frame.tobytes() for frame in padded], 8, setup={"RealBPP": 8})
    np.testing.assert_array_equal(open_recording(cine.write(tmp_path / "a.cine")).read(), frames)


def test_annotations_of_any_size_stand_before_the_pixels(tmp_path):
    frames = frames_of(12)
    cine = Cine(10, -6, [plain(frame) for frame in frames], annotation=b"a note of 21 letters.")
    np.testing.assert_array_equal(open_recording(cine.write(tmp_path / "a.cine")).read(), frames)


def test_time_stamps_give_the_times_and_the_trigger_is_zero(tmp_path):
    frames = frames_of(8)
    stamps = [-0.0071, -0.0031, 0.0009, 0.0049, 0.0089]
    cine = Cine(10, 6, [plain(frame) for frame in frames], 8, stamps=stamps, setup={"FrameRate": 250, "RealBPP": 8})
    recording = open_recording(cine.write(tmp_path / "a.cine"))
    np.testing.assert_allclose(recording.times, stamps, atol=2**-30)  # the resolution of the stamps without their flags
    assert recording.frame_rate == 250
    assert recording.warnings == ()
    assert recording.metadata["exposure_s"] == pytest.approx(0.001)
    assert recording.metadata["serial"] == 4711


def test_without_stamps_the_frame_number_counts_from_the_trigger(tmp_path):
    cine = Cine(10, 6, [plain(frame) for frame in frames_of(8)], 8, setup={"RealBPP": 8}, first_number=-2)
    recording = open_recording(cine.write(tmp_path / "a.cine"))
    np.testing.assert_allclose(recording.times, np.arange(-2, 3) / 300, rtol=1e-14)


def test_a_given_frame_rate_replaces_the_stamps_and_keeps_the_trigger_in_place(tmp_path):
    stamps = list((np.arange(5) - 2) / 300)
    cine = Cine(10, 6, [plain(frame) for frame in frames_of(8)], 8, stamps=stamps, setup={"RealBPP": 8})
    recording = open_recording(cine.write(tmp_path / "a.cine"), frame_rate=1000)
    assert recording.frame_rate == 1000
    np.testing.assert_allclose(recording.times, (np.arange(5) - 2) / 1000, atol=1e-9)


def test_stamps_decide_when_frames_were_left_out_on_saving(tmp_path):
    stamps = list((np.arange(5) - 2) / 300)  # every tenth of 3000 frames a second
    cine = Cine(10, 6, [plain(frame) for frame in frames_of(8)], 8, stamps=stamps)
    cine.setup = {"FrameRate": 3000, "RealBPP": 8}
    recording = open_recording(cine.write(tmp_path / "a.cine"))
    assert recording.frame_rate == pytest.approx(300, rel=1e-6)
    assert any("3000 Hz" in sentence and "300 Hz" in sentence for sentence in recording.warnings)


def test_gaps_and_reset_clocks_are_named(tmp_path):
    gap = Cine(10, 6, [plain(frame) for frame in frames_of(8)], 8, stamps=[-0.01, 0.0, 0.01, 0.05, 0.06])
    gap.setup, gap.first_number = {"FrameRate": 100, "RealBPP": 8}, -1
    recording = open_recording(gap.write(tmp_path / "gap.cine"))
    assert "the first of 3 frames after frame 2" in recording.warnings[0]
    assert recording.frame_rate == 100
    reset = Cine(10, 6, [plain(frame) for frame in frames_of(8)], 8, stamps=list(np.arange(5) / 300 - 9e5))
    reset.setup = {"RealBPP": 8}
    recording = open_recording(reset.write(tmp_path / "reset.cine"))
    np.testing.assert_allclose(recording.times, np.arange(-2, 3) / 300, atol=1e-6)
    assert "reset" in recording.warnings[0]


def test_stamps_that_do_not_increase_are_not_used(tmp_path):
    cine = Cine(10, 6, [plain(frame) for frame in frames_of(8)], 8, stamps=[0.0] * 5, setup={"RealBPP": 8})
    recording = open_recording(cine.write(tmp_path / "a.cine"))
    np.testing.assert_allclose(recording.times, np.arange(-2, 3) / 300)
    assert "do not increase" in recording.warnings[0]


def test_precise_rate_of_newer_cameras_and_short_setup_of_older_ones(tmp_path):
    pixels = [plain(frame) for frame in frames_of(12)]
    new = Cine(10, 6, pixels, setup={"dFrameRate": 299.97, "CameraModel": b"Phantom T1340"})
    recording = open_recording(new.write(tmp_path / "new.cine"))
    assert recording.frame_rate == 299.97
    assert recording.metadata["camera"] == "Phantom T1340"
    old = open_recording(Cine(10, 6, pixels, setup_length=5692).write(tmp_path / "old.cine"))
    assert old.frame_rate == 300
    assert "black_level" not in old.metadata


@pytest.mark.parametrize("lost", [1, 120, 121, 130, 350])
def test_truncated_file_gives_the_frames_that_are_whole(tmp_path, lost):
    frames = frames_of(12)  # 120 bytes each, and 8 before each
    whole = Cine(10, -6, [plain(frame) for frame in frames]).bytes()
    (tmp_path / "cut.cine").write_bytes(whole[:-lost])
    recording = open_recording(tmp_path / "cut.cine")
    left = 5 - -(-lost // 128)
    assert len(recording) == left
    np.testing.assert_array_equal(recording.read(), frames[:left])
    assert recording.warnings[0].startswith(f"truncated: {5 - left} of 5 frames are missing")
    assert len(recording.times) == left


def test_truncated_within_a_long_annotation(tmp_path):
    frames = frames_of(12)
    whole = Cine(10, -6, [plain(frame) for frame in frames], annotation=bytes(100)).bytes()
    (tmp_path / "cut.cine").write_bytes(whole[:-200])
    recording = open_recording(tmp_path / "cut.cine")
    assert len(recording) == 4
    np.testing.assert_array_equal(recording.read(), frames[:4])


def test_damage_beyond_use_is_refused(tmp_path):
    whole = Cine(10, 6, [plain(frame) for frame in frames_of(12)]).bytes()
    for length in (0, 10, 60, 5000, 13570, 13600, 13700):
        (tmp_path / "cut.cine").write_bytes(whole[:length])
        with pytest.raises(FingerflowError, match=r"cut\.cine"):
            open_recording(tmp_path / "cut.cine")


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
    cine = Cine(10, 6, [plain(frame) for frame in frames_of(12)])
    for name, value in change.items():
        setattr(cine, name, value)
    with pytest.raises(FingerflowError, match=named):
        open_recording(cine.write(tmp_path / "a.cine"))


def test_flips_meant_for_players_are_named_and_not_applied(tmp_path):
    frames = frames_of(12)
    cine = Cine(10, -6, [plain(frame) for frame in frames], setup={"bFlipV": 1})
    recording = open_recording(cine.write(tmp_path / "a.cine"))
    np.testing.assert_array_equal(recording.read(), frames)
    assert "bFlipV" in recording.warnings[0]


# Real recordings. The sums (first frame, its upper half) are those of the decoded images that the image correlation
# program DICe ships for the same files; all pixels of all frames were compared once and are equal.
@pytest.mark.parametrize(
    ("name", "dtype", "bits", "rate", "start", "total", "upper_half"),
    [
        ("packed_12bpp", np.uint16, 12, 100, 0.606142, 17124325, 8766652),
        ("packed_raw_12bpp", np.uint16, 12, 100, 0.606142, 17124325, 8766652),
        ("phantom_v12_raw_16bpp", np.uint16, 12, 100, 0.971893, 35108484, 17052471),
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


def test_real_files_whose_numbers_and_clock_disagree_say_so(shared_data):
    recording = open_recording(shared_data / "cine" / "phantom_v9_raw_16bpp.cine")
    assert "791.463 s by its number 237439" in recording.warnings[0]


def test_real_colour_recording_is_refused(shared_data):
    with pytest.raises(FingerflowError, match="colour"):
        open_recording(shared_data / "cine" / "invalid_color.cine")
