"""Facts that files state are used, or named in a warning or error; ambiguous text is refused by its cause."""

import os
import re
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import tifffile
from nptdms import ChannelObject, TdmsWriter

from fingerflow import open_forces, open_recording
from fingerflow.engines.engine import EngineSettings
from fingerflow.engines.native import NativeEngine
from fingerflow.errors import FingerflowError
from fingerflow.kernels.declarations import FRAME_KINDS
from fingerflow.schema.pixel_types import COMPUTED_TYPES
from fingerflow.schema.text_file import read_text
from fingerflow.study.trial_rows import read_rows

TIMES, FORCES = np.arange(0, 0.2, 1e-3), 2 * np.arange(0, 0.2, 1e-3)
LINES = "".join(f"{time:.3f},{force:.4f}\n" for time, force in zip(TIMES, FORCES, strict=True))
GERMAN = "time (s);Fz (N)\n" + LINES.replace(",", ";").replace(".", ",")
HEADING = "time (s),Fz (N)\n"
READ = {
    "UTF-16": (HEADING + LINES).encode("utf-16"),
    "German UTF-16": GERMAN.encode("utf-16"),
    "heading in a comment": ("# " + HEADING + LINES).encode(),
    "MATLAB comment": ("% made by a program\n%" + HEADING + LINES).encode(),
    "comment and blanks": ("# time (s) Fz (N)\n" + LINES.replace(",", " ")).encode(),
    "quoted decimal commas": (HEADING + re.sub(r"(\d)\.(\d+)", r'"\1,\2"', LINES)).encode(),
    "a comma in a quoted name": ('"time (s)","Fz (N)","Fx, left (N)"\n' + re.sub("\n", ",0\n", LINES)).encode(),
}
REFUSED = {
    "German thousands": ("time (s);Fz (N)\n0,001;1.234\n0,002;1.235\n", "thousands"),
    "either": ("time (ms)\tFz (mN)\n0\t1,234\n1\t1,236\n", "'1,234' may be decimal or have a thousands mark"),
    "decimal commas": (HEADING + "0,000,0,00\n0,001,0,10\n", "4 cells below 2 names .*semicolons"),
    "two decimal marks": ("t (s);Fz (N)\n0,001;0.01\n0,002;0.02\n", "'0,001' beside '0.01'.*with one decimal mark"),
    "time of day": (HEADING + "12:00:00.001,1\n12:00:00.002,1\n", "'12:00:00.001', a date or time of day"),
    "footer": (HEADING + LINES + "End of file\n", "'End of file' has 1 cells"),
    "empty": ("time (s),Fz (N),temp (V)\n0,1,2\n1,1,\n", "'temp' is empty"),
    "Fortran": (HEADING + "0,1.0D-03\n1,1\n", "'1.0D-03', a number of Fortran; write its exponent with E"),
    "no number": (HEADING + "0,1\n1,#N/A\n", "'Fz' is '#N/A'"),
    "path": ("recording,answer\np01/0um/a.npy,1\n", "'p01/0um/a.npy', no number"),
    "binary": (HEADING + "0,1\n\0,1\n", "is binary"),
}


@pytest.mark.parametrize("case", READ)
def test_spellings_of_tables_are_read(case: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(READ[case])
    forces = open_forces(tmp_path / "a.csv", channels={"f": "Fz"})
    np.testing.assert_allclose(forces.channels["f"], FORCES, atol=1e-9)
    np.testing.assert_allclose(forces.times, TIMES, atol=1e-9)


@pytest.mark.parametrize("case", REFUSED)
def test_ambiguous_tables_are_refused_by_their_cause(case: str, tmp_path: Path) -> None:
    text, cause = REFUSED[case]
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(FingerflowError, match=cause):
        open_forces(tmp_path / "a.csv")


@pytest.mark.parametrize("case", ["pipe", "device", "folder", "HDF5", "long"])
def test_what_is_no_text_ends_in_a_sentence(case: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    {
        "pipe": lambda: os.mkfifo(path),
        "device": lambda: path.symlink_to("/dev/zero"),
        "folder": path.mkdir,
        "HDF5": lambda: h5py.File(path, "w").close(),
        "long": lambda: path.write_bytes(bytes(1 << 25)),
    }[case]()
    for read in (read_rows, open_forces, lambda path: read_text(path, "name another")):
        with pytest.raises(FingerflowError, match=r"a\.csv: (is|has more than)"):
            read(path)


@pytest.mark.parametrize(
    ("names", "warns"),
    [
        (["i_-12", "i_-2", "i_-1"], "gaps"),
        (["cam0_7", "cam0_8", "cam1_7", "cam1_8"], "count twice"),
        (["1e+999999999", "2e+999999999"], ""),
        (["Img-0002", "Img-0001", "Img+0000", "Img+0001"], ""),
        (["t=0.05", "t=0.5", "t=1", "t=1.5"], "decimal"),
        (["t_5e-2", "t_1e-1", "t_2e-1"], "decimal"),
        (["t0,05", "t0,1", "t0,5", "t1,0"], "decimal"),
        (["cam1.8", "cam1.9", "cam1.10"], ""),
    ],
)
def test_images_are_in_the_order_of_their_numbers(names: list[str], warns: str, tmp_path: Path) -> None:
    for grey, name in enumerate(names):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((16, 24), grey, np.uint8))
    recording = open_recording(tmp_path)
    whole = [index for index in range(len(recording)) if index not in recording.unreadable]
    assert [recording[index][0, 0] for index in whole] == list(range(len(names)))
    assert warns in " ".join(recording.warnings)
    assert bool(warns) == bool(recording.warnings)


# A counter that starts again, a date, hexadecimal numbers; copies in the order of characters, and parallel writers.
@pytest.mark.parametrize("names", ["s254 s255 s000 s001", "30-1 31-1 1-2 2-2", "8 9 a b 10 11 12 13"])
@pytest.mark.parametrize("copied", ["", "1 10 11 12 2 3 4 5", "2 1 4 3 6 5 8 7 10 9 12 11"])
def test_images_whose_names_and_times_have_another_order(names: str, copied: str, tmp_path: Path) -> None:
    for second, name in enumerate((copied or names).split()):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.zeros((16, 24), np.uint8))
        os.utime(tmp_path / f"{name}.png", (second, second))
    assert ("was written before" in " ".join(open_recording(tmp_path).warnings)) == (not copied)


@pytest.mark.parametrize("dtype", [*COMPUTED_TYPES, ">f4", ">f8", ">u2"])
def test_pixel_types_that_are_admitted(dtype: str, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.ones((2, 16, 24), dtype))
    frame = open_recording(tmp_path / "a.npy")[0]
    assert frame.sum() == 384
    assert NativeEngine(EngineSettings()).images(frame[None]).dtype.name in FRAME_KINDS


@pytest.mark.parametrize("dtype", ["uint32", "float16", "int16", "bool"])
def test_pixel_types_that_are_refused(dtype: str, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.ones((2, 16, 24), dtype))
    with pytest.raises(FingerflowError, match="frames are uint8, uint16, float32, float64"):
        open_recording(tmp_path / "a.npy")


@pytest.mark.parametrize(
    ("stamps", "unit", "rate", "warns"),
    [
        (np.arange(5) * 2_000_000 + (1 << 60), "ns", 500.0, ""),
        (np.array([0.0, 2, 4, 8, 10]), "ms", 500.0, ""),
        (np.arange(5) * 2.0, "_ms", 500.0, ""),
        (np.arange(5)[:, None] * 0.002, "seconds", 500.0, ""),
        (np.arange(5) * 2.0, "", None, "not used"),
        (np.array([0.0, 2, 1, 8, 10]), "ms", None, "do not increase"),
        (np.array(5 * [b"12:00:00.002"]), "", None, "are no numbers"),
    ],
)
def test_times_of_frames_in_hdf5(stamps: np.ndarray, unit: str, rate: float | None, warns: str, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["run/frames"] = np.zeros((5, 16, 24), np.uint8)
        times = file["run"].create_dataset("frame_times" + unit * unit.startswith("_"), data=stamps)
        if unit and "_" not in unit:
            times.attrs["units"] = unit
    recording = open_recording(tmp_path / "a.h5")
    assert recording.frame_rate == (None if rate is None else pytest.approx(rate))
    if rate is not None:
        moved = np.ravel(stamps - stamps[0])
        np.testing.assert_allclose(recording.times, moved / moved[1] / rate, atol=1e-9)
    assert bool(warns) == bool(recording.warnings)
    assert warns in " ".join(recording.warnings)


@pytest.mark.parametrize(("late_ms", "step"), [(100, 1e-3), (3, 1e-3), (0, 2e-3)])
def test_clocks_of_tdms_channels(late_ms: int, step: float, tmp_path: Path) -> None:
    begin = np.datetime64("2024-05-01T12:00:00")
    with TdmsWriter(tmp_path / "a.tdms") as writer:
        for name, interval, late in (("Fz", 1e-3, 0), ("ttl", step, late_ms)):
            times = {"wf_increment": interval, "wf_start_time": begin + np.timedelta64(late, "ms")}
            writer.write_segment([ChannelObject(name, name, FORCES, times | {"unit_string": "N"})])
    np.testing.assert_allclose(open_forces(tmp_path / "a.tdms", ["Fz"]).times, TIMES, atol=1e-9)
    with pytest.raises(FingerflowError, match=r"different clocks.*'ttl' every"):
        open_forces(tmp_path / "a.tdms", ["Fz"], trigger="ttl")


def test_tables_and_times_of_groups_in_hdf5(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        rows = np.zeros(200, [("time", "f8"), ("Fz", "f4"), ("note", "S4")])
        rows["time"], rows["Fz"] = TIMES, FORCES
        file["daq/forces"] = rows
        file["sync/time"], file["sync/ttl"] = TIMES + 0.1, FORCES
        file["raw"] = np.round(FORCES * 1000 - 50).astype(np.int16)
        file["raw"].attrs.update(scale_factor=0.001, add_offset=0.05)
        file["nwb"] = FORCES * 1000
        file["nwb"].attrs["conversion"] = 0.001
    options = {"time": "daq/forces/time", "units": dict.fromkeys(("daq/forces/Fz", "raw", "nwb"), "N")}
    forces = open_forces(tmp_path / "a.h5", {"f": "daq/forces/Fz", "raw": "raw", "nwb": "nwb"}, **options)
    for values in forces.channels.values():
        np.testing.assert_allclose(values, FORCES, rtol=1e-6)
    with pytest.raises(FingerflowError, match="'sync/ttl' has times of its own"):
        open_forces(tmp_path / "a.h5", {"f": "daq/forces/Fz"}, trigger="sync/ttl", **options)


@pytest.mark.parametrize(
    ("stated", "rate", "warns"),
    [
        ({"TimeIncrement": 2.0, "TimeIncrementUnit": "ms"}, 500, ""),
        ({"Plane": {"DeltaT": [0, 2, 4, 8, 9]}}, None, "DeltaT"),
        ({"finterval": 0.002, "tunit": "sec", "fps": 10.0}, 500, ""),
        ({"finterval": 2.0, "tunit": "frames"}, None, ""),
    ],
)
def test_times_that_a_tiff_states(stated: dict[str, Any], rate: float | None, warns: str, tmp_path: Path) -> None:
    imagej = "finterval" in stated
    path = tmp_path / ("a.tif" if imagej else "a.ome.tif")
    tifffile.imwrite(path, np.zeros((5, 16, 24), np.uint8), imagej=imagej, metadata={"axes": "TYX"} | stated)
    path.write_bytes(path.read_bytes().replace(b"ImageJ=1.11a", b"ImageJ=1.11\xe9"))  # Latin-1
    recording = open_recording(path)
    assert recording.frame_rate == (None if rate is None else pytest.approx(rate))
    assert warns in "".join(recording.warnings)
    assert bool(warns) == bool(recording.warnings)


@pytest.mark.parametrize(("orientation", "warns"), [(1, False), (3, True), (6, True)])
def test_orientation_that_a_picture_states(orientation: int, warns: bool, tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 255, (16, 24)).astype(np.uint8)
    tag = [("Orientation", "H", 1, orientation, True)]
    tifffile.imwrite(tmp_path / "a.tif", image, photometric="minisblack", extratags=tag)
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0" + bytes([orientation]) + bytes(6)
    jpeg = cv2.imencode(".jpg", image)[1].tobytes()
    (tmp_path / "a.jpg").write_bytes(jpeg[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + jpeg[2:])
    for name in ("a.tif", "a.jpg"):
        assert any("orientation" in warning for warning in open_recording(tmp_path / name).warnings) == warns
