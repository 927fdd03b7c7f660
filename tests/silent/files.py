"""Cases of damaged files, files that contradict their headers, requests that no page sends, and loss of power.

Flipped bits of pixels are no case in formats without a checksum (raw frames, BMP, H.264): the file stays valid and
cannot be told from a recording.
"""

import http.client
import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from unittest import mock

import h5py
import numpy as np

from fingerflow.errors import FingerflowError
from fingerflow.recordings import open_forces, open_recording
from fingerflow.results.atomic_write import write_atomically
from fingerflow.view.server import Served
from tests.fuzz.samples import COUNT, GREY8, samples
from tests.fuzz.worker import damaged, write
from tests.recordings.camera_files import write_video
from tests.recordings.hdf5_index import damaged_indexes
from tests.silent.case import Case

_FLIPPED, _DAMAGED = 60, 1000  # numbers of damaged files per case
_FILTERS = {"none": {}, "gzip": {"compression": "gzip"}, "fletcher32": {"fletcher32": True},
            "gzip, fletcher32": {"compression": "gzip", "fletcher32": True}}  # fmt: skip
_BODIES = (b"", b"{", b"[]", b"5", b"{}", b"[" * 99_999, b'{"set": [5]}', b'{"set": [["a.b", {"toml": 1}]]}',
           b'{"to": "\\u0000"}', b'{"key": 1}', b'{"of": "frame", "frame": "x"}', b"\xff")  # fmt: skip


def cases() -> Iterator[Case]:
    """Yield the cases; the numbers count files or requests."""
    with tempfile.TemporaryDirectory() as folder:
        yield from _hdf5(Path(folder))
        yield from _videos(Path(folder))
        yield from _fewer(Path(folder))
        yield _rate(Path(folder))
        yield _forces(Path(folder))
        yield _requests(Path(folder))
        yield _power(Path(folder))


def _case(name: str, count: int, unit: str, stated: str, wrong: int) -> Case:
    return Case(name, f"{wrong} of {count} {unit}", f"0 of {count}", stated, "wrong in silence" if wrong else "told")


def _silent(path: Path, truth: np.ndarray, known: tuple[str, ...] = ()) -> tuple[bool, str]:
    """Return whether a file gives frames other than `truth` without a warning, and the response to the file."""
    try:
        with open_recording(path) as recording:
            frames = recording.read()
            if set(recording.warnings) - set(known):
                return False, "warned"
            if frames.shape != truth.shape:
                return len(frames) < len(truth), "fewer frames"
            told = {*recording.unreadable, *recording.doubtful}
            differ = {k for k in range(len(truth)) if not np.array_equal(frames[k], truth[k])}
            return bool(differ - told), "frames unreadable" if told else "frames right"
    except FingerflowError:
        return False, "refused"


def _answers(found: list[tuple[bool, str]]) -> tuple[str, int]:
    said = [answer for _, answer in found]
    counts = ", ".join(f"{said.count(one)} {one}" for one in sorted(set(said)))
    return counts, sum(wrong for wrong, _ in found)


def _hdf5(folder: Path) -> Iterator[Case]:
    for filters, options in _FILTERS.items():
        path = folder / "a.h5"
        stated, wrong = _answers([_silent(path, GREY8) for _ in damaged_indexes(path, GREY8, **options)])
        yield _case(f"HDF5, index of chunks damaged, filters {filters}", 16, "files", stated, wrong)


def _videos(folder: Path) -> Iterator[Case]:
    for name, codec in (("a.mov", "png"), ("a.avi", "png"), ("a.mkv", "ffv1"), ("b.avi", "ffv1")):
        path = write_video(folder / name, GREY8, codec, "gray", threads="1")
        whole, found = path.read_bytes(), []
        for place in np.random.default_rng(35).integers(0, len(whole), _FLIPPED):
            data = bytearray(whole)
            data[place] ^= 4
            path.write_bytes(data)
            found.append(_silent(path, GREY8))
        stated, wrong = _answers(found)
        yield _case(f"{codec} in {path.suffix}, a bit flipped", _FLIPPED, "files", stated, wrong)


def _fewer(folder: Path) -> Iterator[Case]:
    for reader in ("cine", "tiff", "mraw", "npy"):
        (folder / reader).mkdir()
        found, silent, told = samples(reader, folder / reader), 0, 0
        for number in range(_DAMAGED):
            sample, data = damaged(found, reader, 35, number)
            try:
                with open_recording(write(sample, folder / "damaged", data)) as recording:
                    whole = 1 if sample.damaged in ("one.tif", "3.npy") else COUNT
                    silent += len(recording) < whole and not recording.warnings
                    told += len(recording) < whole and bool(recording.warnings)
            except FingerflowError:
                continue
        stated = f"{told} with a warning of what is missing or left"
        yield _case(f"{reader}, fewer frames than were stored", _DAMAGED, "files", stated, silent)


def _refusal(act: Callable[[], object]) -> str:
    """Return the error message without the name of the file; "" if there is no error."""
    try:
        act()
    except FingerflowError as error:
        return str(error).partition(": ")[2]
    return ""


def _rate(folder: Path) -> Case:
    np.save(folder / "a.npy", GREY8)
    said = _refusal(lambda: open_recording(folder / "a.npy", frame_rate=2.3e-308))
    return Case("frame_rate = 2.3e-308 Hz", "none" if said else "infinite times", "no rate", said,
                "told" if said else "wrong in silence")  # fmt: skip


def _forces(folder: Path) -> Case:
    with h5py.File(folder / "f.h5", "w") as file:
        file["time"] = np.arange(40) / 1000
        file["time"].attrs["units"] = "s"
        file.create_dataset("Fz [raw]", (40,), "f8", chunks=(10,))[:30] = 2.0
        file["Fz [raw]"].attrs["units"] = "N"
    said = _refusal(lambda: open_forces(folder / "f.h5"))
    return Case("HDF5 forces, a quarter never written", "none" if said else "0 N", "2 N", said,
                "told" if said else "wrong in silence")  # fmt: skip


def _requests(folder: Path) -> Case:
    paths = ("edit", "calibrate", "write", "process", "end", "report", "result/history", "result/table")
    answers = []
    with Served(folder / "a.npy") as served:
        opened = _ask(served.port, "GET", served.address.partition(str(served.port))[2], b"", {})
        cookie = str(opened.getheader("set-cookie")).partition(";")[0]
        for path in paths:
            for body in _BODIES:
                headers = {"Cookie": cookie, "X-Fingerflow": "1"}
                answers.append(_ask(served.port, "POST", f"/api/{path}", body, headers).status)
    wrong = sum(status >= 500 for status in answers)
    return _case("requests that no page sends", len(answers), "answers 500", f"{answers.count(422)} sentences", wrong)


def _ask(port: int, method: str, path: str, body: bytes, headers: dict[str, str]) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", port)
    connection.request(method, path, body, headers)
    answer = connection.getresponse()
    answer.read()
    connection.close()
    return answer


def _power(folder: Path) -> Case:
    """Judge, by the calls of fsync, the order in which content and name of a replaced file reach the disk."""
    path, order = folder / "a.txt", []
    path.write_text("before")

    def note(_: int) -> None:
        order.append(path.read_text())

    with mock.patch.object(os, "fsync", note):
        write_atomically(path, lambda part: part.write_text("after"))
    right = order == ["before", "after"]
    return Case("loss of power while a file is replaced", f"{len(order)} syncs", "2 syncs",
                "content before the name, name at the end", "told" if right else "wrong in silence")  # fmt: skip
