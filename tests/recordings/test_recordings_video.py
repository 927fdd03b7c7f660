"""Tests of videos encoded by the test: every frame exactly, in any order, in bounded memory."""

import av
import numpy as np
import pytest

from fingerflow.errors import FingerflowError
from fingerflow.recordings import open_recording
from fingerflow.recordings.frames import video
from tests.recordings.camera_files import write_video

HEIGHT, WIDTH, COUNT = 48, 80, 60


def frames_of(bits: int) -> np.ndarray:
    """Return a moving pattern (COUNT, HEIGHT, WIDTH) whose mean encodes the number of the frame."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    top = 2**bits - 1
    frames = [top * (0.2 + 0.6 * n / COUNT + 0.1 * np.sin((x + 2 * n) / 7) * np.cos(y / 5)) for n in range(COUNT)]
    return np.array(frames).astype(np.uint8 if bits == 8 else np.uint16)


LOSSLESS = [
    ("a.avi", "rawvideo", "gray", 8),
    ("a.mkv", "ffv1", "gray12le", 12),
    ("a.mkv", "ffv1", "gray16le", 16),
    ("a.avi", "rawvideo", "bgr24", 8),
    ("a.mov", "png", "gray", 8),
    ("a.mkv", "ffv1", "yuv420p10le", 10),
]


@pytest.mark.parametrize(("name", "codec", "pixel_format", "bits"), LOSSLESS)
def test_lossless_formats_come_back_bit_for_bit(tmp_path, name, codec, pixel_format, bits):
    frames = frames_of(bits)
    recording = open_recording(write_video(tmp_path / name, frames, codec, pixel_format))
    assert (len(recording), recording.frame_shape) == (COUNT, (HEIGHT, WIDTH))
    assert (recording.dtype, recording.bit_depth) == (frames.dtype, bits)
    np.testing.assert_array_equal(recording.read(), frames)
    assert recording.frame_rate == pytest.approx(300, rel=1e-6)
    np.testing.assert_allclose(recording.times, np.arange(COUNT) / 300, rtol=1e-6)
    luma = "yuv" in pixel_format
    assert any("luma" in sentence for sentence in recording.warnings) == luma
    assert len(recording.warnings) == luma


INTER_CODED = [
    ("a.mov", "libx264", {"bf": "3", "g": "1000", "qp": "10"}),
    ("a.mkv", "libx264", {"bf": "3", "g": "7", "qp": "10", "x264-params": "open-gop=1"}),
    ("a.avi", "libx264", {"bf": "3", "g": "12", "qp": "10"}),
    ("a.mkv", "libvpx-vp9", {"g": "15"}),
]


@pytest.mark.parametrize(("name", "codec", "options"), INTER_CODED, ids=lambda value: str(value))
def test_inter_coded_video_gives_the_same_frames_in_any_order(tmp_path, name, codec, options):
    frames = frames_of(8)
    path = write_video(tmp_path / name, frames, codec, "yuv420p", **options)
    with av.open(str(path)) as container:  # the reference: one pass from the start
        straight = [
            np.frombuffer(f.planes[0], np.uint8).reshape(HEIGHT, -1)[:, :WIDTH].copy()
            for f in container.decode(video=0)
        ]
    assert len(straight) == COUNT
    recording = open_recording(path)
    assert len(recording) == COUNT
    for order in (np.arange(COUNT), np.arange(COUNT)[::-1], np.random.default_rng(1).permutation(COUNT)):
        fresh = open_recording(path)
        np.testing.assert_array_equal(fresh[order].read(), np.array(straight)[order])
        assert not fresh.doubtful
    # Each frame is the right one, not just reproducible: its mean encodes its number (the codec changes it by < 1).
    means = recording.read().mean((1, 2))
    assert np.abs(means - frames.mean((1, 2))).max() < 1.0  # steps between frames are 2.55


def test_reading_backwards_decodes_each_group_once_and_keeps_few_frames(tmp_path, monkeypatch):
    path = write_video(tmp_path / "a.mp4", frames_of(8), "libx264", "yuv420p", bf="0", g="20", sc_threshold="0")
    decoded = []
    original = video._Pixels.convert
    monkeypatch.setattr(
        video._Pixels, "convert", lambda self, f, p, number: decoded.append(number) or original(self, f, p, number)
    )
    recording = open_recording(path)
    assert decoded == []
    recording[::-1].read()
    assert len(decoded) == COUNT
    # With a cache of 5 frames a group of 20 is decoded again for every 5 frames: 20 + 15 + 10 + 5 frames.
    monkeypatch.setattr(video, "CACHE_BYTES", 5 * HEIGHT * WIDTH)
    decoded.clear()
    small = open_recording(path)
    small[::-1].read()
    assert len(decoded) == 3 * (20 + 15 + 10 + 5)
    assert len(small.file._cache) <= 5
    small.close()
    assert not small.file._cache
    with pytest.raises(FingerflowError, match="the file is closed"):  # and is not opened again
        small[0].read()


@pytest.mark.parametrize(("name", "codec"), [("a.avi", "rawvideo"), ("a.mkv", "ffv1")])
def test_truncated(tmp_path, name, codec):
    frames = frames_of(8)
    path = write_video(tmp_path / name, frames, codec, "gray")
    data = path.read_bytes()
    path.write_bytes(data[: int(0.7 * len(data))])
    recording = open_recording(path)
    assert 0.6 * COUNT < len(recording) < 0.8 * COUNT
    assert recording.warnings == (
        f"truncated: {COUNT - len(recording)} of {COUNT} frames are missing at the end of the file",
    )
    np.testing.assert_array_equal(recording.read(), frames[: len(recording)])


@pytest.mark.parametrize(
    ("name", "first", "step", "dropped", "hertz"),
    [("a.avi", 0, 10, 3, 78.5714), ("a.mkv", 0, 10, 3, 78.5714), ("a.avi", 0, 20, 0, 50), ("a.mkv", 300, 10, 0, 100)],
)
def test_time_stamps_tell_dropped_frames_from_a_missing_end(tmp_path, name, first, step, dropped, hertz):
    ticks = [first + step * (k + dropped * (k > 3)) for k in range(12)]
    path = write_video(tmp_path / name, frames_of(8)[:12], "ffv1", "gray", rate=1000, ticks=ticks)
    recording = open_recording(path)
    assert recording.frame_rate == pytest.approx(hertz)
    assert recording.warnings == (
        (f"frames are not evenly spaced; {hertz:g} Hz is their average rate",) * (dropped > 0)
    )
    np.testing.assert_allclose(recording.times, (np.array(ticks) - first) / 1000)


@pytest.mark.parametrize("codec", ["mpeg2video", "mpeg4", "libx264"])
@pytest.mark.parametrize("options", [{}, {"flags": "+ilme+ildct", "top": "1"}, {"aspect": "4:3"}])
def test_interlaced_rows_and_wide_pixels_are_named(tmp_path, codec, options):
    path = write_video(tmp_path / "a.mkv", frames_of(8), codec, "yuv420p", rate=25, **options)
    said = " ".join(open_recording(path).warnings)
    assert ("the video is interlaced" in said) == ("flags" in options)
    assert ("wide pixels (" in said) == ("aspect" in options)


@pytest.mark.parametrize("reordered", ["0", "2"])
def test_frames_that_an_edit_list_leaves_out_are_not_missing(tmp_path, reordered):
    ticks = range(-3, COUNT - 3)
    path = write_video(tmp_path / "a.mp4", frames_of(8), "libx264", "gray", ticks=ticks, bf=reordered, qp="0")
    recording = open_recording(path)
    np.testing.assert_array_equal(recording.read(), frames_of(8)[3:])
    assert "missing" not in "".join(recording.warnings)


def test_mp4_without_its_index_is_refused(tmp_path):
    path = write_video(tmp_path / "a.mp4", frames_of(8), "libx264", "yuv420p")
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(FingerflowError, match="damaged"):
        open_recording(path)


def test_a_frame_with_real_colour_is_refused_by_its_number(tmp_path):
    frames = np.repeat(frames_of(8)[..., None], 3, -1)
    frames[5, 10, 10, 0] ^= 8
    recording = open_recording(write_video(tmp_path / "a.avi", frames, "rawvideo", "bgr24"))
    np.testing.assert_array_equal(recording[:5].read(), frames[:5, ..., 0])
    with pytest.raises(FingerflowError, match="frame 5 has real colour"):
        recording[5]


def test_unknown_pixel_format_is_named(tmp_path):
    path = write_video(tmp_path / "a.mkv", frames_of(16), "ffv1", "gbrp16le")
    with pytest.raises(FingerflowError, match="gbrp16le"):
        open_recording(path)
