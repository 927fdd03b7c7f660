"""Tests of reading forces from files of every kind, written by the test: time, channels, units and refused files.

Text files include LabVIEW measurement files, notes before the table, and tables without a heading.
"""

import sys

import h5py
import numpy as np
import pytest
import scipy.io
from nptdms import ChannelObject, TdmsWriter

from fingerflow.errors import FingerflowError
from fingerflow.recordings import open_forces

TIMES = np.arange(50) / 1000
NORMAL = np.linspace(0, 5, 50)
TANGENTIAL = np.sin(TIMES * 40)
TRIGGER = np.where(TIMES < 0.0205, 0.0, 5.0)


def text(tmp_path, content, name="forces.csv", encoding="utf-8"):
    (tmp_path / name).write_bytes(content.encode(encoding))
    return tmp_path / name


def rows(separator=",", decimal=".", scale=1.0, end="", columns=(NORMAL, TANGENTIAL, TRIGGER)):
    lines = []
    for values in zip(TIMES * scale, *columns, strict=True):
        lines.append(separator.join(f"{value:.9g}".replace(".", decimal) for value in values) + end)
    return "\n".join(lines) + "\n"


def check(forces, normal="normal", tangential="tangential", factor=1.0):
    np.testing.assert_allclose(forces.times, TIMES, atol=1e-12)
    np.testing.assert_allclose(forces.channels[normal], NORMAL * factor, rtol=1e-8)
    np.testing.assert_allclose(forces.channels[tangential], TANGENTIAL, rtol=1e-8, atol=1e-9)
    assert forces.units[normal] == forces.units[tangential] == "N"
    assert all(values.dtype == np.float64 for values in forces.channels.values())


HEADING = "time (s),normal (N),tangential [N],trigger (V)\n"
CSV = {
    "comma": HEADING + rows(),
    "tab and decimal comma": HEADING.replace(",", "\t") + rows("\t", ","),
    "blanks": "time (s) normal (N)  tangential[N] trigger (V)\n" + rows(" "),
    "comments between the samples": HEADING + rows().replace("\n", "\n\n   \n# paused\n", 3) + "// the end\n",
    "milliseconds": "Time [ms],normal (N),tangential [N],trigger (V)\n" + rows(scale=1000),
    "bars": "t (s)|normal (N)|tangential (N)|trigger (V)\n" + rows("|"),
    "line of units": "t;normal;tangential;trigger\ns;N;N;V\n" + rows(";"),
    "separator at the end": HEADING.replace("\n", ",\n") + rows(end=","),
    "carriage returns": (HEADING + rows()).replace("\n", "\r\n"),
    "notes in quotes": '"made by"\n"a program"\n"time (s)","normal (N)","tangential [N]","trigger (V)"\n' + rows(),
    "notes as wide as the table": "Rate\t1000\tHz\tof 4\nName\tpress\t3\t-\n" + HEADING.replace(",", "\t") + rows("\t"),
    "notes, heading and units": "Export of DAQ 2.1\nx\n2021-05-02\ntime;normal;tangential;trigger\n[s];[N];[N];[V]\n"
    + rows(";", ","),
}


@pytest.mark.parametrize("kind", CSV)
def test_delimited_text(tmp_path, kind):
    forces = open_forces(text(tmp_path, CSV[kind]), trigger="trigger")
    check(forces)
    assert list(forces.channels) == ["normal", "tangential", "trigger"]
    assert forces.units["trigger"] == "V"


@pytest.mark.parametrize(
    ("unit", "factor", "encoding"), [("µN", 1e-6, "utf-8-sig"), ("uN", 1e-6, "latin-1"), ("g", 9.80665e-3, "latin-1")]
)
def test_forces_become_newtons(tmp_path, unit, factor, encoding):
    content = f"time (s),normal ({unit}),tangential [N],trigger (mV)\n" + rows()
    forces = open_forces(text(tmp_path, content, encoding=encoding))
    check(forces, factor=factor)
    np.testing.assert_allclose(forces.channels["trigger"], TRIGGER * 1e-3)
    assert forces.units["trigger"] == "V"


def test_units_given_go_before_the_file(tmp_path):
    path = text(tmp_path, "time,normal,tangential (mN),trigger\n" + rows())
    forces = open_forces(path, units={"normal": "mN", "tangential": "N", "time": "s"}, trigger="trigger")
    check(forces, factor=1e-3)
    assert forces.units["trigger"] == ""  # no unit is stated; a level suffices to align


def test_channels_are_chosen_and_renamed(tmp_path):
    path = text(tmp_path, CSV["comma"])
    assert list(open_forces(path, channels=["tangential"]).channels) == ["tangential"]
    forces = open_forces(path, channels={"N": "normal", "T": "tangential"}, trigger="trigger")
    check(forces, "N", "T")
    assert list(forces.channels) == ["N", "T", "trigger"]
    assert forces.trigger == "trigger"
    assert open_forces(path, channels={"sync": "trigger"}, trigger="trigger").trigger == "sync"
    with pytest.raises(FingerflowError, match=r'Two columns\? In the scene write .* = \["normal", "tangential"\]$'):
        open_forces(path, {"T": "normal, tangential"})


@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), ("\t", ","), ("  ", ",")])
def test_without_a_heading_columns_have_numbers(tmp_path, separator, decimal):
    path = text(tmp_path, rows(separator, decimal))
    check(open_forces(path, {"normal": 2, "tangential": 3}, units={2: "N", 3: "N"}, time=1))
    with pytest.raises(FingerflowError, match=r"has no column 5; it has 4, numbered from 1: 'column_1', "):
        open_forces(path, {"normal": 5}, units={5: "N"}, time=1)
    units = {"column_2": "N", "column_3": "N"}
    check(open_forces(path, ["column_2", "column_3"], units, time="column_1"), "column_2", "column_3")


def lvm(x_columns, table, decimal="."):
    """Return the text that Write To Measurement File of LabVIEW 2020 writes."""
    return (
        f"LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\n"
        f"Decimal_Separator\t{decimal}\n"
        f"Multi_Headings\tNo\nX_Columns\t{x_columns}\nTime_Pref\tAbsolute\nOperator\tlab\nDate\t2021/05/02\n"
        "Time\t10:30:00,5\n***End_of_Header***\t\n\t\nChannels\t2\t\t\nSamples\t50\t50\t\nDate\t2021/05/02\t2021/05/02\t\n"
        f"X_Dimension\tTime\tTime\t\nX0\t0{decimal}0\t0{decimal}0\t\nDelta_X\t0{decimal}001\t0{decimal}001\t\n"
        f"***End_of_Header***\t\t\t\nX_Value\tnormal\ttangential\tComment\n{table}"
    )


@pytest.mark.parametrize(("times", "decimal"), [("One", "."), ("One", ","), ("No", ".")])
def test_labview(tmp_path, times, decimal):
    table = rows("\t", decimal, columns=(NORMAL, TANGENTIAL))
    if times == "No":
        table = "".join("\t" + line.partition("\t")[2] + "\n" for line in table.splitlines())
    path = text(tmp_path, lvm(times, table, decimal).replace("\n", "\r\n"), "press.lvm", "latin-1")
    check(open_forces(path, units={"normal": "N", "tangential": "N"}))


def test_labview_of_several_segments_is_refused(tmp_path):
    table = rows("\t", columns=(NORMAL, TANGENTIAL))
    path = text(tmp_path, lvm("One", table + "Channels\t2\n***End_of_Header***\t\n" + table), "two.lvm")
    with pytest.raises(FingerflowError, match=r"two\.lvm: is a LabVIEW file of 2 segments.*write one a file"):
        open_forces(path)


def test_a_sample_rate_that_the_times_contradict_is_refused(tmp_path):
    path = text(tmp_path, CSV["comma"])
    np.testing.assert_allclose(open_forces(path, sample_rate=1000).times, TIMES)
    rounded = "".join(f"{time:.2f},{force}\n" for time, force in zip(TIMES, NORMAL, strict=True))
    few_digits = text(tmp_path, "time (s),normal (N)\n" + rounded, "rounded.csv")
    with pytest.raises(FingerflowError, match=r"not later.*give sample_rate in Hz"):
        open_forces(few_digits)
    np.testing.assert_allclose(open_forces(few_digits, sample_rate=1000).times, TIMES)
    with pytest.raises(FingerflowError, match=r"sample_rate=500 Hz, but its column 'time' in s says 1000 Hz. Leave"):
        open_forces(path, sample_rate=500)
    milliseconds = text(tmp_path, "time,normal (N)\n" + "".join(f"{n},{n}\n" for n in range(9)), "ms.csv")
    with pytest.raises(FingerflowError, match=r"says 1 Hz.*'time \(ms\)'"):
        open_forces(milliseconds, sample_rate=1000)


def test_a_line_that_is_cut_off_does_not_count(tmp_path):
    path = text(tmp_path, CSV["comma"].rstrip().rpartition(",")[0])
    forces = open_forces(path)
    np.testing.assert_allclose(forces.times, TIMES[:-1])
    (warning,) = forces.warnings
    assert warning.startswith(f"{path}: the last line has no line break, so its last number may be cut off: the line")
    assert "left out" in warning
    whole = open_forces(text(tmp_path, CSV["comma"].rstrip()))
    np.testing.assert_array_equal(whole.times, TIMES)
    assert "the line is read" in whole.warnings[0]


@pytest.mark.parametrize(
    ("content", "options", "named"),
    [
        (CSV["comma"], {"channels": ["normal", "shear"]}, r"'shear'.*'normal', 'tangential', 'trigger'"),
        (CSV["comma"], {"trigger": "sync"}, r"'sync'.*'trigger'"),
        ("time (s),normal (lbf)\n0,1\n1,2\n", {}, r"in 'lbf'.* scene give \[forces\] units \(N, mN, g, kgf or V\)"),
        ("t,way\n0,1\n1,2\n", {"lengths": ["way"]}, r"'way' has no unit.*units=.* scene write \(mm\) in its heading"),
        ("time (s),normal (N),normal (N)\n0,1,2\n", {}, "'normal' appears twice"),
        ("", {}, "no line"),
    ],
)
def test_refused_by_name(tmp_path, content, options, named):
    with pytest.raises(FingerflowError, match=named) as refusal:
        open_forces(text(tmp_path, content), **options)
    assert "forces.csv" in str(refusal.value)


# HDF5


def test_hdf5(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"], file["normal"], file["tangential"] = TIMES * 1000, NORMAL, TANGENTIAL.astype(np.float32)
        file["note"] = "a text"
        file["time"].attrs["units"] = "ms"
        file["normal"].attrs["units"] = "mN"
        file["tangential"].attrs["unit"] = "N"
        file["frames"] = np.zeros((3, 4, 5))
    forces = open_forces(tmp_path / "a.h5")
    np.testing.assert_allclose(forces.times, TIMES)
    np.testing.assert_allclose(forces.channels["normal"], NORMAL * 1e-3)
    np.testing.assert_allclose(forces.channels["tangential"], TANGENTIAL, atol=1e-7)
    assert list(forces.channels) == ["normal", "tangential"]


def test_hdf5_with_groups_a_matrix_and_a_rate(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["trial/forces"] = np.stack([NORMAL, TANGENTIAL], 1)
        file["trial/forces"].attrs["units"] = "N"
        file.attrs["sample_rate"] = 1000.0
    forces = open_forces(tmp_path / "a.h5", {"normal": "trial/forces[0]", "tangential": "trial/forces[1]"})
    check(forces)
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["trial/forces"].attrs["sample_rate"] = 2000.0
    with pytest.raises(FingerflowError, match="several sample rates"):
        open_forces(tmp_path / "a.h5")


# MATLAB


def test_matlab_v5(tmp_path):
    content = {"t": TIMES, "normal": NORMAL[:, None], "tangential": TANGENTIAL, "subject": "P01", "age": 30.0}
    scipy.io.savemat(tmp_path / "a.mat", content | {"units": {"normal": "N", "tangential": "N"}})
    check(open_forces(tmp_path / "a.mat"))


def test_matlab_v73(tmp_path):
    # MATLAB writes with -v7.3: HDF5 after a block of 512 bytes, vectors as (1, n), the class in an attribute.
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        for name, values in (("time", TIMES), ("normal", NORMAL), ("tangential", TANGENTIAL)):
            file[name] = values[:, None]
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with open(tmp_path / "a.mat", "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: PCWIN64".ljust(124, b" ") + b"\x00\x02IM")
    check(open_forces(tmp_path / "a.mat", units={"normal": "N", "tangential": "N"}))


# TDMS


def tdms(path, **properties):
    properties = {"wf_increment": 0.001, "wf_start_offset": 0.0, "unit_string": "N"} | properties
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [
                ChannelObject("forces", "normal", NORMAL, properties),
                ChannelObject("forces", "tangential", TANGENTIAL, properties),
                ChannelObject("sync", "trigger", TRIGGER, properties | {"unit_string": "V"}),
            ]
        )
    return path


def test_tdms(tmp_path):
    forces = open_forces(tdms(tmp_path / "a.tdms"), trigger="trigger")
    check(forces)
    np.testing.assert_array_equal(forces.channels["trigger"], TRIGGER)
    late = open_forces(tdms(tmp_path / "b.tdms", wf_start_offset=0.25))
    np.testing.assert_allclose(late.times, TIMES + 0.25)


def test_tdms_without_a_rate_and_with_times_of_groups(tmp_path):
    path = tdms(tmp_path / "a.tdms", wf_increment=0.0)
    with pytest.raises(FingerflowError, match="sample_rate in Hz"):
        open_forces(path)
    check(open_forces(path, sample_rate=1000))
    with TdmsWriter(tmp_path / "b.tdms") as writer:
        for group, name, late in (("a", "x", 0), ("b", "y", 0.1)):
            columns = {"time": TIMES + late, name: NORMAL}.items()
            writer.write_segment([ChannelObject(group, *column, {"unit_string": "s"}) for column in columns])
    with pytest.raises(FingerflowError, match="'b/y' has times of its own"):
        open_forces(tmp_path / "b.tdms", ["a/x"], {"a/x": "N"}, time="a/time", trigger="b/y")


@pytest.mark.parametrize(("module", "name"), [("pymatreader", "a.mat"), ("nptdms", "a.tdms")])
def test_missing_extra_says_how_to_install_it(tmp_path, monkeypatch, module, name):
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / name).write_bytes(b"x")
    with pytest.raises(FingerflowError, match=f"pip install {module}"):
        open_forces(tmp_path / name)
