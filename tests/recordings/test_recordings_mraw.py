"""Tests of Photron `.mraw` with its `.cih` or `.cihx`: written by the test, and a real pair."""

import numpy as np
import pytest

from fingerflow.errors import FingerflowError
from fingerflow.recordings import open_recording
from tests.recordings.camera_files import pack_bits, write_photron

FRAMES = np.random.default_rng(3).integers(0, 4096, (6, 5, 8)).astype(np.uint16)
BYTES = (FRAMES >> 4).astype(np.uint8)


def stored(frames: np.ndarray) -> bytes:
    return frames.astype("<u2").tobytes()


NOVA = {"Camera_Type": "FASTCAM Nova S16 type 1100K-M-64GB", "Color_Type": "Raw", "File_Format": "Mraw"}


@pytest.mark.parametrize(
    ("data", "header", "changes", "frames", "bits"),
    [
        (stored(FRAMES), ".cih", {}, FRAMES, 12),
        (stored(FRAMES), ".cihx", NOVA, FRAMES, 12),
        (stored(FRAMES << 4), ".cih", {"EffectiveBit_Side": "Higher"}, FRAMES, 12),
        (b"".join(pack_bits(frame, 12) for frame in FRAMES), ".cih", {"Color_Bit": 12}, FRAMES, 12),
        # Only eight of the sensor's twelve bits are saved.
        (BYTES.tobytes(), ".cih", {"Color_Bit": 8, "EffectiveBit_Side": "Higher"}, BYTES, 8),
    ],
    ids=["16 bits", "XML header", "upper bits", "12 bits packed", "8 bits"],
)
def test_frames_and_times_from_either_file_of_the_pair(tmp_path, data, header, changes, frames, bits):
    path = write_photron(tmp_path, data, header, **changes)
    recording = open_recording(path.with_suffix(header))
    assert open_recording(path).metadata == recording.metadata
    np.testing.assert_array_equal(recording.read(), frames)
    np.testing.assert_array_equal(recording.mapped(), frames)
    assert (recording.dtype, recording.bit_depth) == (frames.dtype, bits)
    assert recording.frame_rate == 300  # every tenth frame at 3000 Hz was saved
    np.testing.assert_allclose(recording.times, (np.arange(6) * 10 - 20) / 3000)
    assert recording.metadata["exposure_s"] == pytest.approx(65.06e-6)
    assert recording.metadata["sensor_bits"] == 12
    assert recording.metadata["camera"] == changes.get("Camera_Type", "FASTCAM SA-Z type 2100K-M-64GB")


def test_truncated(tmp_path):
    recording = open_recording(write_photron(tmp_path, stored(FRAMES)[:-90]))
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
        ({"File_Format": "TIFF"}, "TIFF"),
        ({"Image_Width": "wide"}, "'wide'"),
        ({"Total_Frame": ""}, "Total Frame"),
        ({"Record_Rate(fps)": 0}, "Record Rate"),
        ({"Save_Step": -1}, "correct the header"),
    ],
)
def test_refused_by_name(tmp_path, changes, named):
    with pytest.raises(FingerflowError, match=named):
        open_recording(write_photron(tmp_path, FRAMES.tobytes(), **changes))


@pytest.mark.parametrize(("missing", "opened"), [(".cih", ".mraw"), (".mraw", ".cih")])
def test_one_file_of_the_pair_alone(tmp_path, missing, opened):
    path = write_photron(tmp_path, stored(FRAMES))
    path.with_suffix(missing).unlink()
    with pytest.raises(FingerflowError, match=rf"\{missing}"):
        open_recording(path.with_suffix(opened))


def test_real_recording(shared_data):
    recording = open_recording(shared_data / "mraw" / "data_showcase.mraw")
    assert (len(recording), recording.frame_shape, recording.bit_depth) == (75, (40, 640), 8)
    assert recording.frame_rate == 150  # 15000 Hz, one frame in a hundred saved
    assert recording.times[-1] == pytest.approx(74 / 150)
    raw = np.fromfile(shared_data / "mraw" / "data_showcase.mraw", np.uint8).reshape(75, 40, 640)
    np.testing.assert_array_equal(recording[::-1].read(), raw[::-1])
