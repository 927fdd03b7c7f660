"""Photron `.mraw` with its `.cih` or `.cihx`: written by the test, and a real pair."""

from pathlib import Path

import numpy as np
import pytest
from cine_writer import pack_bits

from fingerflow.errors import FingerflowError
from fingerflow.recordings import open_recording

FRAMES = np.random.default_rng(3).integers(0, 4096, (6, 5, 8)).astype(np.uint16)


def write_pair(folder: Path, data: bytes, header: str = ".cih", **changes: object) -> Path:
    entries = {
        "Camera Type": "FASTCAM SA-Z type 2100K-M-64GB",
        "Record Rate(fps)": 3000,
        "Shutter Type2(nsec)": 65060,
        "Total Frame": 6,
        "Start Frame": -20,
        "Save Step": 10,
        "Image Width": 8,
        "Image Height": 5,
        "Color Type": "Mono",
        "Color Bit": 16,
        "File Format": "MRaw",
        "EffectiveBit Depth": 12,
        "EffectiveBit Side": "Lower",
    } | {name.replace("_", " "): value for name, value in changes.items()}
    (folder / "take 1.mraw").write_bytes(data)
    text = "#Camera Information Header\r\nComment Text : mesure \xe0 5 N\r\n"
    text += "".join(f"{name} : {value}\r\n" for name, value in entries.items())
    text += "\r\nEND\r\nImage Width : 999\r\n"
    (folder / f"take 1{header}").write_bytes(text.encode("latin-1"))
    return folder / "take 1.mraw"


@pytest.mark.parametrize("opened", ["take 1.mraw", "take 1.cih"])
def test_sixteen_bit_from_either_file_of_the_pair(tmp_path, opened):
    write_pair(tmp_path, FRAMES.astype("<u2").tobytes())
    recording = open_recording(tmp_path / opened)
    np.testing.assert_array_equal(recording.read(), FRAMES)
    np.testing.assert_array_equal(recording.mapped(), FRAMES)
    assert recording.bit_depth == 12
    assert recording.frame_rate == 300  # every tenth of 3000 frames a second was saved
    np.testing.assert_allclose(recording.times, (np.arange(6) * 10 - 20) / 3000)
    assert recording.metadata["exposure_s"] == pytest.approx(65.06e-6)


def test_bits_on_the_higher_side_are_shifted_down(tmp_path):
    path = write_pair(tmp_path, (FRAMES << 4).astype("<u2").tobytes(), EffectiveBit_Side="Higher")
    recording = open_recording(path)
    np.testing.assert_array_equal(recording.read(), FRAMES)
    np.testing.assert_array_equal(recording.mapped(), FRAMES)
    assert recording.bit_depth == 12


def test_twelve_bit_packed(tmp_path):
    path = write_pair(tmp_path, b"".join(pack_bits(frame, 12) for frame in FRAMES), Color_Bit=12)
    recording = open_recording(path)
    np.testing.assert_array_equal(recording.read(), FRAMES)
    np.testing.assert_array_equal(recording.mapped(), FRAMES)
    assert (recording.bit_depth, recording.dtype) == (12, np.dtype(np.uint16))


def test_eight_bits_of_a_twelve_bit_sensor_are_eight(tmp_path):
    frames = (FRAMES >> 4).astype(np.uint8)
    recording = open_recording(write_pair(tmp_path, frames.tobytes(), Color_Bit=8, EffectiveBit_Side="Higher"))
    np.testing.assert_array_equal(recording.read(), frames)
    assert recording.bit_depth == 8
    assert recording.metadata["sensor_bits"] == 12


def test_xml_header_between_binary_blocks(tmp_path):
    path = write_pair(tmp_path, FRAMES.astype("<u2").tobytes(), header=".unused")
    xml = """<cih><imageFileInfo><fileFormat>Mraw</fileFormat></imageFileInfo>
    <imageDataInfo><resolution><width>8</width><height>5</height></resolution>
    <colorInfo><type>Raw</type><bit>16</bit></colorInfo>
    <effectiveBit><depth>12</depth><side>Lower</side></effectiveBit></imageDataInfo>
    <frameInfo><totalFrame>6</totalFrame><startFrame>52</startFrame><skipFrame>2</skipFrame></frameInfo>
    <recordInfo><recordRate>2000</recordRate><shutterSpeedNsec>20000</shutterSpeedNsec></recordInfo>
    <deviceInfo><deviceName>FASTCAM Nova S16 type 1100K-M-64GB</deviceName></deviceInfo></cih>"""
    (tmp_path / "take 1.cihx").write_bytes(b"\x00\xffCIHX" + xml.encode() + b"\x01\x02")
    recording = open_recording(path)
    np.testing.assert_array_equal(recording.read(), FRAMES)
    np.testing.assert_array_equal(recording.mapped(), FRAMES)
    assert recording.frame_rate == 1000
    assert recording.times[0] == pytest.approx(52 / 2000)
    assert recording.metadata["camera"].startswith("FASTCAM Nova")


def test_truncated(tmp_path):
    recording = open_recording(write_pair(tmp_path, FRAMES.astype("<u2").tobytes()[:-90]))
    assert len(recording) == 4
    np.testing.assert_array_equal(recording.read(), FRAMES[:4])
    assert recording.warnings == ("truncated: 2 of 6 frames are missing at the end of the file",)
    with pytest.raises(FingerflowError, match="not one frame"):
        open_recording(write_pair(tmp_path, b"123"))


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
        open_recording(write_pair(tmp_path, FRAMES.tobytes(), **changes))


def test_one_file_of_the_pair_alone(tmp_path):
    path = write_pair(tmp_path, FRAMES.tobytes())
    (tmp_path / "take 1.cih").unlink()
    with pytest.raises(FingerflowError, match=r"\.cih"):
        open_recording(path)
    path = write_pair(tmp_path, FRAMES.tobytes())
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
