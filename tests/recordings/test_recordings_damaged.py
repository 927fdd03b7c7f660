"""Tests of damaged, truncated or incomplete recordings and of special files: named, flagged or refused,
never guessed.
"""

import os
import re
import struct
import zlib
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
import tifffile
from test_recordings_mraw import FRAMES as MRAW_FRAMES
from test_recordings_mraw import stored
from test_recordings_video import COUNT, frames_of

from fingerflow.errors import FingerflowError
from fingerflow.recordings import open_forces, open_recording
from tests.recordings.camera_files import Cine, write_photron, write_video
from tests.recordings.hdf5_index import damaged_indexes

RNG = np.random.default_rng(23)
GREY = RNG.integers(1, 256, (6, 20, 30)).astype(np.uint8)
GREY16 = RNG.integers(1, 4096, (6, 20, 30)).astype(np.uint16)

# Special files


@pytest.mark.parametrize("name", ["a.tif", "a.h5", "a.mkv", "a.png", "take 1.cih"])
def test_a_pipe_is_refused_and_not_waited_for(tmp_path, name):
    write_photron(tmp_path, stored(MRAW_FRAMES), ".other")
    os.mkfifo(tmp_path / name)
    with pytest.raises(FingerflowError, match=rf"{name}: is a pipe, not a file; copy"):
        open_recording(tmp_path / ("take 1.mraw" if name == "take 1.cih" else name))


# Folders of images


def numbered(folder: Path, numbers, pattern="frame_{:03d}.png") -> Path:
    for number in numbers:
        cv2.imwrite(str(folder / pattern.format(number)), np.full((8, 9), number, np.uint8))
    return folder


def test_a_missing_number_is_a_frame_that_cannot_be_read(tmp_path):
    recording = open_recording(numbered(tmp_path, [5, 15, 35, 45]), frame_rate=100)
    assert len(recording) == 5
    assert dict(recording.unreadable) == {2: "has no file"}
    np.testing.assert_array_equal(recording.read()[:, 0, 0], [5, 15, 0, 35, 45])
    np.testing.assert_allclose(recording.times, np.arange(5) / 100)  # frames after the gap keep their times
    assert "1 of 5 images are missing by their numbers, the first between" in recording.warnings[0]
    assert dict(recording[1:4].unreadable) == {1: "has no file"}


def damaged_image(folder: Path) -> Path:
    for number, frame in enumerate(GREY):
        cv2.imwrite(str(folder / f"{number}.png"), frame)
    (folder / "3.png").write_bytes((folder / "3.png").read_bytes()[:-40])
    return folder


def damaged_chunk(folder: Path) -> Path:
    with h5py.File(folder / "a.h5", "w") as file:
        file.create_dataset("x", data=GREY, chunks=(1, 20, 30), compression="gzip", fletcher32=True)
        place = file["x"].id.get_chunk_info(3).byte_offset
    return flipped(folder / "a.h5", place + 30)


def write_pages(folder: Path, **settings: str) -> Path:
    path = folder / "a.tif"
    with tifffile.TiffWriter(path) as writer:
        for frame in GREY:
            writer.write(frame, photometric="minisblack", metadata=None, contiguous=False, **settings)
    return path


def damaged_page(folder: Path) -> Path:
    path = write_pages(folder, compression="zlib")
    with tifffile.TiffFile(path) as file:
        place = file.pages[3].dataoffsets[0]
    return flipped(path, place + 40)


@pytest.mark.parametrize("damaged", [damaged_image, damaged_chunk, damaged_page])
def test_a_damaged_part_is_one_frame_less(tmp_path, damaged):
    recording = open_recording(damaged(tmp_path))
    assert not recording.unreadable  # no frame has been read yet
    frames = recording.read()
    assert list(recording.unreadable) == [3]
    np.testing.assert_array_equal(np.delete(frames, 3, 0), np.delete(GREY, 3, 0))


def huge_png(path: Path, side: int) -> Path:
    """Write a PNG file of 1 kB whose header states side x side pixels."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(bytes(10**6))) + chunk(b"IEND", b""))
    return path


def test_a_picture_that_claims_gigabytes_is_refused_before_it_is_decoded(tmp_path, monkeypatch):
    monkeypatch.setattr(cv2, "imdecode", None)
    with pytest.raises(FingerflowError, match=r"a\.png: its header says 60000 x 60000 pixels, which a file of"):
        open_recording(huge_png(tmp_path / "a.png", 60_000))


# HDF5


def test_a_virtual_data_set_without_its_source_is_refused(tmp_path):
    with h5py.File(tmp_path / "source.h5", "w") as file:
        file["x"] = GREY
    layout = h5py.VirtualLayout(GREY.shape, "u1")
    layout[:] = h5py.VirtualSource("source.h5", "x", GREY.shape)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_virtual_dataset("frames", layout)
    with open_recording(tmp_path / "a.h5") as recording:
        np.testing.assert_array_equal(recording.read(), GREY)
    with h5py.File(tmp_path / "source.h5", "a") as file:
        file.move("x", "y")
    with pytest.raises(FingerflowError, match=r"lie in x of .*source\.h5, which is not in it"):
        open_recording(tmp_path / "a.h5")
    (tmp_path / "source.h5").unlink()
    with pytest.raises(FingerflowError, match=r"the values of /frames lie in source\.h5, which is not there; copy"):
        open_recording(tmp_path / "a.h5")


def test_frames_that_were_never_written_are_no_frames(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        frames = file.create_dataset("x", (10, 20, 30), "u1", chunks=(1, 10, 30))
        frames[:3], frames[4, :10], frames[5] = GREY[:3], GREY[4, :10], GREY[5]
    recording = open_recording(tmp_path / "a.h5")
    assert len(recording) == 6
    assert recording.warnings == ("truncated: 4 of 10 frames are missing at the end of the file",)
    assert dict(recording.unreadable) == {3: "was never written", 4: "was never written"}
    np.testing.assert_array_equal(recording[[0, 2, 5]].read(), GREY[[0, 2, 5]])
    assert not recording[4].any()
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file.create_dataset("x", (10, 20, 30), "u1")
    with pytest.raises(FingerflowError, match="was created but never written"):
        open_recording(tmp_path / "b.h5")


@pytest.mark.parametrize("options", [{}, {"compression": "gzip", "shuffle": True, "fletcher32": True}])
def test_a_damaged_index_of_chunks_gives_no_wrong_frame(tmp_path, options):
    said = {}
    for done in damaged_indexes(tmp_path / "a.h5", GREY, **options):
        try:
            with open_recording(tmp_path / "a.h5") as recording:
                right = [np.array_equal(frame, one) for frame, one in zip(recording.read(), GREY, strict=True)]
                said[done] = set(np.flatnonzero(~np.array(right))) - set(recording.unreadable)
        except FingerflowError as error:
            said[done] = str(error)
    assert [done for done, wrong in said.items() if isinstance(wrong, set) and wrong] == []
    assert "index of /x is damaged: two chunks lie in the same bytes; copy" in said["address of a chunk shifted"]
    assert "chunk (9, 0, 0) is outside its grid" in said["place of a chunk outside the grid"]
    if "fletcher32" in options:  # without the check HDF5 crashes
        assert "chunk (2, 0, 0) of 3 bytes lacks its checksum" in said["size of a chunk 3"]


def test_forces_that_were_never_written_are_refused(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"] = np.arange(40) / 1000
        file["time"].attrs["units"] = "s"
        normal = file.create_dataset("Fz [raw]", (40,), "f8", chunks=(10,))
        normal.attrs["units"] = "mN"
        normal[:30] = 2000.0
    with pytest.raises(FingerflowError, match=r"a\.h5: /Fz \[raw\] \(40,\) has no values from \(30,\) on .*copy"):
        open_forces(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["Fz [raw]"][30:] = 2000.0
    np.testing.assert_array_equal(open_forces(tmp_path / "a.h5").channels["Fz [raw]"], np.full(40, 2.0))


@pytest.mark.parametrize("rate", [-1.0, 2.3e-308, np.inf])
def test_a_frame_rate_that_cannot_be_is_none(tmp_path, rate):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = GREY
        file["x"].attrs["frame_rate"] = rate
    with open_recording(tmp_path / "a.h5") as recording:
        assert (recording.frame_rate, recording.times) == (None, None)
        assert recording.warnings == (
            f"the file states a frame rate of {rate:g} Hz, which cannot be; the recording has none",
        )
    with open_recording(tmp_path / "a.h5", frame_rate=300.0) as recording:
        assert recording.times[-1] == pytest.approx(5 / 300)
    with pytest.raises(FingerflowError, match=rf"a\.h5: frame_rate={re.escape(str(rate))} was given; it must lie"):
        open_recording(tmp_path / "a.h5", frame_rate=rate)


def test_a_file_that_ends_the_process_that_looks_at_it_first_is_refused(tmp_path, monkeypatch):
    from fingerflow.recordings.guard import child_process

    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = GREY
    for body, said in (
        ("import os; os.abort()", "crashed"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGPROF)", "did not come to an end within 10 s"),
        ("print(chr(34) + 'it is wrong' + chr(34), flush=True)", "it is wrong"),
        ("import time; time.sleep(600)", "did not come to an end"),
    ):
        script = tmp_path / "walk.py"
        script.write_text(f"import sys\nprint(chr(34) + 'ready' + chr(34), flush=True)\nfor _ in sys.stdin: {body}\n")
        with monkeypatch.context() as patch:
            patch.setattr(child_process.child_reader, "__file__", str(script))
            patch.setattr(child_process, "_child", child_process._ChildProcess())
            patch.setattr(child_process, "_MOST_SECONDS", 5.0)
            message = rf"a\.h5: is damaged, or no hdf5 file: .*{said}.*copy or export it again"
            with pytest.raises(FingerflowError, match=message):
                open_recording(tmp_path / "a.h5")
            child_process._child.close()
    assert len(open_recording(tmp_path / "a.h5")) == 6


# TIFF


def test_pages_in_the_same_bytes_are_no_frames(tmp_path):
    path = write_pages(tmp_path)
    with tifffile.TiffFile(path) as file:
        tag = file.pages[3].tags["StripOffsets"]
        earlier = file.pages[1].dataoffsets[0]
    with path.open("r+b") as file:
        file.seek(tag.valueoffset)
        file.write(struct.pack("<I", earlier + 8))
    recording = open_recording(path)
    recording.read()
    assert dict(recording.unreadable) == dict.fromkeys((1, 3), "lies in the same bytes as another frame, or as itself")


# Files that hold more than their headers state


def fewer_mraw(folder: Path) -> Path:
    return write_photron(folder, stored(MRAW_FRAMES), Total_Frame=4)


def fewer_cine(folder: Path) -> Path:
    pixels = [frame.tobytes() for frame in GREY]
    data = bytearray(Cine(30, -20, pixels, 8, setup={"RealBPP": 8}).bytes())
    struct.pack_into("<I", data, 20, 4)  # ImageCount
    (folder / "a.cine").write_bytes(data)
    return folder / "a.cine"


def fewer_npy(folder: Path) -> Path:
    np.save(folder / "a.npy", GREY)
    (folder / "a.npy").write_bytes((folder / "a.npy").read_bytes().replace(b"(6, ", b"(4, "))
    return folder / "a.npy"


def fewer_pages(folder: Path) -> Path:
    path = write_pages(folder, compression="zlib")
    with tifffile.TiffFile(path) as file:
        place = file.pages[3].offset + file.tiff.tagnosize + len(file.pages[3].tags) * file.tiff.tagsize
    with path.open("r+b") as file:
        file.seek(place)
        file.write(bytes(4))  # no page follows this one
    return path


@pytest.mark.parametrize("fewer", [fewer_mraw, fewer_cine, fewer_npy, fewer_pages])
def test_frames_behind_those_of_the_header_are_told(tmp_path, fewer):
    recording = open_recording(fewer(tmp_path))
    assert len(recording) == 4
    (sentence,) = recording.warnings
    assert re.match(r"the header states 4 frames, and the file holds \d more behind them, which are not read", sentence)


# Photron


def test_a_header_cut_before_its_depth_changes_no_scale(tmp_path):
    path = write_photron(tmp_path, stored(MRAW_FRAMES))
    header = tmp_path / "take 1.cih"
    whole = header.read_bytes()
    for cut, said in (
        (whole.index(b"EffectiveBit Depth"), "does not state 'EffectiveBit Depth'"),
        (whole.index(b"Bit Depth : 12") + len(b"Bit Depth : 1"), "does not state 'EffectiveBit Depth'"),
        (whole.index(b"EffectiveBit Side"), "does not state 'EffectiveBit Side'"),
        (whole.index(b"Color Bit"), "no entry 'Color Bit'"),
    ):
        header.write_bytes(whole[:cut])
        with pytest.raises(FingerflowError, match=rf"take 1\.cih: .*{said}.*[Cc]opy"):
            open_recording(path)
    header.write_bytes(whole[: whole.index(b"\r\nEND")])
    recording = open_recording(path)
    assert recording.bit_depth == 12
    assert "no line END" in recording.warnings[0]
    assert open_recording(write_photron(tmp_path, stored(MRAW_FRAMES))).warnings == ()


# Videos


def flipped(path: Path, place: int) -> Path:
    data = bytearray(path.read_bytes())
    data[place] ^= 4
    path.write_bytes(data)
    return path


def test_frames_of_a_damaged_video_are_flagged(tmp_path):
    """Every frame of FFV1 has a checksum. H.264 has none: of a flipped bit most videos flag the frames up to the next
    key frame, or report an error of the decoder; the other frames decode to other pixels without an error.
    """
    frames, rng = frames_of(8), np.random.default_rng(8)
    for name, codec, pixels, options, most in (
        ("a.mkv", "ffv1", "gray", {"g": "1"}, 0),
        ("a.mp4", "libx264", "yuv420p", {"g": "12", "bf": "0", "qp": "10"}, 3),
        ("a.mov", "libx264", "yuv420p", {"g": "12", "bf": "3", "qp": "10"}, 3),
    ):
        path = write_video(tmp_path / name, frames, codec, pixels, **options)
        whole, clean = path.read_bytes(), open_recording(path).read()
        flagged = silent = 0
        for place in rng.integers(len(whole) // 10, len(whole) * 8 // 10, 10):
            path.write_bytes(whole)
            with open_recording(flipped(path, int(place))) as recording:
                read = recording.read()
                bad, doubtful = recording.unreadable, set(recording.doubtful)
                if bad and codec != "ffv1":
                    assert set(bad) == set(range(min(bad), max(bad) + 1))
                    assert (max(bad) + 1) % 12 == 0  # up to the next key frame
                assert set(recording[5:].doubtful) == {n - 5 for n in doubtful if n >= 5}
                flagged += bool(bad or doubtful)
                wrong = {n for n in range(COUNT) if not np.array_equal(read[n], clean[n])}
                silent += bool(wrong - set(bad) - doubtful)
        assert flagged >= 5, name
        assert silent <= most, name


@pytest.mark.parametrize(
    ("name", "codec", "pixels", "options", "lossy"),
    [
        ("a.mp4", "libx264", "yuv420p", {"qp": "10"}, "h264"),
        ("a.mkv", "libx264", "yuv420p", {"qp": "0"}, None),
        ("a.avi", "mjpeg", "yuvj420p", {}, "mjpeg"),
        ("a.mkv", "ffv1", "gray", {}, None),
    ],
)
def test_lossy_codecs_are_named(tmp_path, name, codec, pixels, options, lossy):
    recording = open_recording(write_video(tmp_path / name, frames_of(8)[:12], codec, pixels, **options))
    assert recording.lossy == lossy == recording[2:5].lossy
    assert sum("is a lossy codec" in sentence for sentence in recording.warnings) == (lossy is not None)
    cv2.imwrite(str(tmp_path / "a.jpg"), GREY[0])
    assert open_recording(tmp_path / "a.jpg").lossy == "jpeg"
