"""Tests common to all recordings: lazy reading, slices, times, and errors on opening."""

import numpy as np
import pytest
import tifffile

from fingerflow.errors import FingerflowError
from fingerflow.recordings import open_recording
from fingerflow.recordings.frames.recording import FrameFile

FRAMES = np.random.default_rng(5).integers(0, 65536, (11, 4, 6)).astype(np.uint16)


@pytest.fixture
def path(tmp_path):
    np.save(tmp_path / "frames.npy", FRAMES)
    return tmp_path / "frames.npy"


@pytest.fixture
def reads(monkeypatch):
    """Return a list that collects the numbers of the frames that are read, in order."""
    numbers: list[int] = []
    original = FrameFile.decode

    def counted(self, index):
        numbers.append(index)
        return original(self, index)

    monkeypatch.setattr(FrameFile, "decode", counted)
    return numbers


def test_no_frame_is_read_before_it_is_asked_for(path, reads):
    recording = open_recording(path, frame_rate=300)
    view = recording[2:10][::-1][[0, 3, -1]]
    assert len(view) == 3
    assert view.times is not None
    assert repr(recording) == "<Recording frames.npy: 11 frames of 4 x 6, uint16, 16 bit, 300 Hz>"
    assert reads == []
    np.testing.assert_array_equal(view[1], FRAMES[6])
    assert reads == [6]
    part = recording[:4]
    assert reads == [6]
    part.read()
    assert reads == [6, 0, 1, 2, 3]


def test_frames_that_fit_into_memory_are_decoded_once(tmp_path, reads):
    tifffile.imwrite(tmp_path / "frames.tif", FRAMES, compression="zlib")
    recording = open_recording(tmp_path / "frames.tif")
    recording.file.kept_bytes = 3 * FRAMES[0].nbytes
    for _ in range(2):
        np.testing.assert_array_equal(recording[:5].read(), FRAMES[:5])
    assert reads == [0, 1, 2, 3, 4, 3, 4]


@pytest.mark.parametrize(
    "key",
    [slice(2, 9, 3), slice(8, 1, -2), slice(5, 5), slice(-3, None), [-1, 0, 0], [], np.array([4, -2]), range(1, 8, 2)],
    ids=str,
)
def test_slices_and_lists_choose_as_numpy_does(path, key):
    recording = open_recording(path, frame_rate=100)
    expected = FRAMES[np.asarray(key, dtype=int) if isinstance(key, (list, range)) else key]
    view = recording[key]
    assert len(view) == len(expected)
    np.testing.assert_array_equal(view.read(), expected)
    np.testing.assert_array_equal(view.mapped(), expected)
    assert all(np.array_equal(frame, wanted) for frame, wanted in zip(view, expected, strict=True))
    expected_times = (np.arange(11) / 100)[np.asarray(key, dtype=int) if isinstance(key, (list, range)) else key]
    np.testing.assert_allclose(view.times, expected_times)


@pytest.mark.parametrize(
    ("change", "key", "copies"),
    [
        (np.ascontiguousarray, slice(2, 9, 3), False),
        (np.ascontiguousarray, [4, 5, 7], True),  # uneven steps
        (np.ascontiguousarray, slice(None, None, -1), True),  # tensors have no negative strides
        (np.asfortranarray, slice(2, 9), True),
        (lambda frames: frames.astype(">u2"), slice(2, 9), True),
    ],
)
def test_frames_that_lie_ready_in_the_file_are_not_copied(tmp_path, reads, change, key, copies):
    np.save(tmp_path / "frames.npy", change(FRAMES))
    with open_recording(tmp_path / "frames.npy") as recording:
        frames = recording[key].mapped()
        assert bool(reads) == copies
        assert frames.flags.writeable == copies  # the file is read-only
        assert frames.dtype == np.uint16
    np.testing.assert_array_equal(frames, FRAMES[key])  # also after the recording is closed


def test_numbers_of_frames(path):
    recording = open_recording(path)
    frame = recording[-1]
    np.testing.assert_array_equal(frame, FRAMES[10])
    frame[:] = 0  # a copy
    np.testing.assert_array_equal(recording[-1], FRAMES[10])
    np.testing.assert_array_equal(recording[9:0:-3][[0, -1]].read(), FRAMES[9:0:-3][[0, -1]])
    np.testing.assert_array_equal(recording[np.int64(3)], FRAMES[3])
    for wrong in (11, -12):
        with pytest.raises(IndexError, match="11 frames"):
            recording[wrong]
        with pytest.raises(IndexError, match="11 frames"):
            recording[[0, wrong]]
    with pytest.raises(TypeError, match="flatnonzero"):
        recording[np.ones(11, bool)]


def test_rate_is_never_guessed_and_follows_the_view(path):
    recording = open_recording(path)
    assert recording.frame_rate is None
    assert recording.times is None
    recording = open_recording(path, frame_rate=300)
    np.testing.assert_allclose(recording.times, np.arange(11) / 300)
    assert recording[::3].frame_rate == 100
    assert recording[[1, 3, 5]].frame_rate == 150


def test_wrong_paths_name_the_path_and_the_way_out(tmp_path, path):
    with pytest.raises(FingerflowError, match=r"missing\.npy.*no such file"):
        open_recording(tmp_path / "missing.npy")
    (tmp_path / "notes.docx").write_text("hello")
    with pytest.raises(FingerflowError, match=r"\.docx.*\.cine"):
        open_recording(tmp_path / "notes.docx")
    with pytest.raises(FingerflowError, match="HDF5"):
        open_recording(f"{path}::/frames")


@pytest.mark.parametrize("suffix", ["cine", "cih", "tif", "avi", "mkv", "h5", "npy", "png"])
def test_a_file_of_another_kind_than_its_suffix_says(tmp_path, suffix):
    for content in (b"", b"this is text and nothing else\n" * 40):
        (tmp_path / f"a.{suffix}").write_bytes(content)
        with pytest.raises(FingerflowError, match=rf"a\.{suffix}"):
            open_recording(tmp_path / f"a.{suffix}")


def test_larger_than_memory_opens_at_once(tmp_path):
    # 200,000 frames in a sparse file, which would take 52 GB on disk.
    shape = (200_000, 512, 256)
    with open(tmp_path / "huge.npy", "wb") as file:
        np.lib.format.write_array_header_2_0(file, {"descr": "<u2", "fortran_order": False, "shape": shape})
        start = file.tell()
        file.seek(start + 2 * 512 * 256 * 180_000)
        file.write(np.arange(512 * 256, dtype="<u2").tobytes())
        file.truncate(start + 2 * 512 * 256 * 200_000)
    recording = open_recording(tmp_path / "huge.npy")
    assert len(recording) == 200_000
    np.testing.assert_array_equal(recording[180_000].reshape(-1), np.arange(512 * 256).astype(np.uint16))
    assert recording[-1].max() == 0
