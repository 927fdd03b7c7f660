"""Photron `.mraw` with its `.cih` or `.cihx`: written by the test, and a real pair."""

import numpy as np
import pytest

from fingerflow.errors import FingerflowError
from fingerflow.recordings import open_recording
from tests.recordings.camera_files import pack_bits, write_photron

FRAMES = np.random.default_rng(3).integers(0, 4096, (6, 5, 8)).astype(np.uint16)


@pytest.mark.parametrize("opened", ["take 1.mraw", "take 1.cih"])
def test_sixteen_bit_from_either_file_of_the_pair(tmp_path, opened):
    write_photron(tmp_path, FRAMES.astype("<u2").tobytes())
    recording = open_recording(tmp_path / opened)
    np.testing.assert_array_equal(recording.read(), FRAMES)
    np.testing.assert_array_equal(recording.mapped(), FRAMES)
    assert recording.bit_depth == 12
    assert recording.frame_rate == 300  # every tenth of 3000 frames a second was saved
    np.testing.assert_allclose(recording.times, (np.arange(6) * 10 - 20) / 3000)
    assert recording.metadata["exposure_s"] == pytest.approx(65.06e-6)


def test_bits_on_the_higher_side_are_shifted_down(tmp_path):
    path = write_photron(tmp_path, (FRAMES << 4).astype("<u2").tobytes(), EffectiveBit_Side="Higher")
    recording = open_recording(path)
    np.testing.assert_array_equal(recording.read(), FRAMES)
    np.testing.assert_array_equal(recording.mapped(), FRAMES)
    assert recording.bit_depth == 12


def test_twelve_bit_packed(tmp_path):
    path = write_photron(tmp_path, b"".join(pack_bits(frame, 12) for frame in FRAMES), Color_Bit=12)
    recording = open_recording(path)
    np.testing.assert_array_equal(recording.read(), FRAMES)
    np.testing.assert_array_equal(recording.mapped(), FRAMES)
    assert (recording.bit_depth, recording.dtype) == (12, np.dtype(np.uint16))


def test_eight_bits_of_a_twelve_bit_sensor_are_eight(tmp_path):
    frames = (FRAMES >> 4).astype(np.uint8)
    recording = open_recording(write_photron(tmp_path, frames.tobytes(), Color_Bit=8, EffectiveBit_Side="Higher"))
    np.testing.assert_array_equal(recording.read(), frames)
    assert recording.bit_depth == 8
    assert recording.metadata["sensor_bits"] == 12


def test_xml_header_between_binary_blocks(tmp_path):
    entries = {"File_Format": "Mraw", "Color_Type": "Raw", "Start_Frame": 52, "Save_Step": 2, "Record_Rate(fps)": 2000}
    entries["Camera_Type"] = "FASTCAM Nova S16 type 1100K-M-64GB"
    path = write_photron(tmp_path, FRAMES.astype("<u2").tobytes(), ".cihx", **entries)
    recording = open_recording(path)
    np.testing.assert_array_equal(recording.read(), FRAMES)
    np.testing.assert_array_equal(recording.mapped(), FRAMES)
    assert recording.frame_rate == 1000
    assert recording.times[0] == pytest.approx(52 / 2000)
    assert recording.metadata["camera"].startswith("FASTCAM Nova")


def test_truncated(tmp_path):
    recording = open_recording(write_photron(tmp_path, FRAMES.astype("<u2").tobytes()[:-90]))
    assert len(recording) == 4
    np.testing.assert_array_equal(recording.read(), FRAMES[:4])
    assert recording.warnings == ("truncated: 2 of 6 frames are missing at the end of the file",)
    with pytest.raises(FingerflowError, match="not one frame"):
        open_recording(write_photron(tmp_path, b"123"))


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"Color_Type": "Color", "Color_Bit": 24}, "colour"),
        ({"Color_Type": "Raw", "Camera_Type": "FASTCAM SA-Z type 2100K-C-64GB"}, "colour"),
        ({"Color_Bit": 10}, "Color Bit 10"),
        ({"File_Format": "TIFF"}, "TIFF"),
        ({"Image_Width": "wide"}, "'wide'"),
        ({"Total_Frame": ""}, "Total Frame"),
        ({"Image_Width": 0}, "0 x 5"),
        ({"Record_Rate(fps)": 0}, "Record Rate"),
    ],
)
def test_refused_by_name(tmp_path, changes, named):
    with pytest.raises(FingerflowError, match=named):
        open_recording(write_photron(tmp_path, FRAMES.tobytes(), **changes))


def test_one_file_of_the_pair_alone(tmp_path):
    path = write_photron(tmp_path, FRAMES.tobytes())
    (tmp_path / "take 1.cih").unlink()
    with pytest.raises(FingerflowError, match=r"\.cih"):
        open_recording(path)
    path = write_photron(tmp_path, FRAMES.tobytes())
    path.unlink()
    with pytest.raises(FingerflowError, match=r"\.mraw"):
        open_recording(tmp_path / "take 1.cih")


def test_real_recording(shared_data):
    recording = open_recording(shared_data / "mraw" / "data_showcase.mraw")
    assert (len(recording), recording.frame_shape, recording.bit_depth) == (75, (40, 640), 8)
    assert recording.frame_rate == 150  # 15000 a second, one in a hundred saved
    assert recording.times[-1] == pytest.approx(74 / 150)
    raw = np.fromfile(shared_data / "mraw" / "data_showcase.mraw", np.uint8).reshape(75, 40, 640)
    np.testing.assert_array_equal(recording[::-1].read(), raw[::-1])
