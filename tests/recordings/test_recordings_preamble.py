"""Force files as programs write them: LabVIEW measurement files, notes before the table, no heading at all."""

from pathlib import Path

import numpy as np
import pytest

from fingerflow.errors import FingerflowError
from fingerflow.recordings import Forces, open_forces

TIMES = np.arange(40) / 1000
NORMAL = np.linspace(0, 5, 40)
SHEAR = np.sin(40 * TIMES)
UNITS = {"normal": "N", "shear": "N"}


def rows(separator: str, decimal: str = ".", times: bool = True, end: str = "") -> str:
    columns = [TIMES, NORMAL, SHEAR] if times else [NORMAL, SHEAR]
    lines = (separator.join(f"{value:.9g}" for value in values) + end for values in zip(*columns, strict=True))
    return "\n".join(lines).replace(".", decimal) + "\n"


def written(folder: Path, content: str, name: str = "forces.txt", encoding: str = "utf-8") -> Path:
    (folder / name).write_bytes(content.encode(encoding))
    return folder / name


def check(forces: Forces, normal: str = "normal", shear: str = "shear") -> None:
    np.testing.assert_allclose(forces.times, TIMES, atol=1e-12)
    np.testing.assert_allclose(forces.channels[normal], NORMAL, rtol=1e-8)
    np.testing.assert_allclose(forces.channels[shear], SHEAR, rtol=1e-8, atol=1e-9)


def lvm(x_columns: str, table: str, separator: str = "\t", decimal: str = ".") -> str:
    """What Write To Measurement File of LabVIEW 2020 writes."""
    word = "Tab" if separator == "\t" else "Comma"
    return (
        f"LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\t{word}\n"
        f"Decimal_Separator\t{decimal}\n"
        f"Multi_Headings\tNo\nX_Columns\t{x_columns}\nTime_Pref\tAbsolute\nOperator\tlab\nDate\t2021/05/02\n"
        "Time\t10:30:00,5\n***End_of_Header***\t\n\t\nChannels\t2\t\t\nSamples\t40\t40\t\nDate\t2021/05/02\t2021/05/02\t\n"
        f"X_Dimension\tTime\tTime\t\nX0\t0{decimal}0\t0{decimal}0\t\nDelta_X\t0{decimal}001\t0{decimal}001\t\n"
        f"***End_of_Header***\t\t\t\n{table}"
    )


@pytest.mark.parametrize("decimal", [".", ","])
def test_labview_with_a_time_column(tmp_path: Path, decimal: str) -> None:
    table = "X_Value\tnormal\tshear\tComment\n" + rows("\t", decimal)
    path = written(tmp_path, lvm("One", table, decimal=decimal).replace("\n", "\r\n"), "press.lvm", "latin-1")
    check(open_forces(path, units=UNITS))


def test_labview_without_a_time_column(tmp_path: Path) -> None:
    lines = "".join("\t" + line + "\n" for line in rows("\t", times=False).splitlines())
    check(open_forces(written(tmp_path, lvm("No", "X_Value\tnormal\tshear\tComment\n" + lines), "a.lvm"), units=UNITS))


def test_labview_of_several_segments_is_refused(tmp_path: Path) -> None:
    table = "X_Value\tnormal\tshear\tComment\n" + rows("\t")
    path = written(tmp_path, lvm("One", table + "Channels\t2\n***End_of_Header***\t\n" + table), "two.lvm")
    with pytest.raises(FingerflowError, match=r"two\.lvm: is a LabVIEW file of 2 segments.*write one a file"):
        open_forces(path, units=UNITS)


PREAMBLES = {
    "notes": "Force plate 3\nOperator: M. Curie\nDate: 2 May, 2021\n\ntime (s),normal (N),shear (N)\n" + rows(","),
    "keys and values as wide as the table": "Rate\t1000\tHz\nName\tpress\t3\ntime\tnormal (N)\tshear (N)\n"
    + rows("\t"),
    "heading and units": "Export of DAQ 2.1\nx\n2021-05-02\ntime;normal;shear\n[s];[N];[N]\n" + rows(";", ","),
    "quotes": '"made by"\n"a program"\n"time (s)","normal (N)","shear (N)"\n' + rows(","),
}


@pytest.mark.parametrize("kind", PREAMBLES)
def test_what_stands_before_the_table_is_passed_over(tmp_path: Path, kind: str) -> None:
    forces = open_forces(written(tmp_path, PREAMBLES[kind]))
    check(forces)
    assert forces.units == UNITS


@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), (";", "."), (";", ","), ("\t", ","), ("\t", "."), (" ", "."), ("  ", ",")]
)
def test_columns_by_their_numbers_without_a_heading(tmp_path: Path, separator: str, decimal: str) -> None:
    path = written(tmp_path, rows(separator, decimal))
    forces = open_forces(path, {"normal": 2, "shear": 3}, units={2: "N", 3: "N"}, time=1)
    check(forces)
    with pytest.raises(FingerflowError, match=r"has no column 4; it has 3, numbered from 1: 'column_1', "):
        open_forces(path, {"normal": 4}, units={4: "N"}, time=1)


def test_numbers_below_a_heading_too(tmp_path: Path) -> None:
    check(open_forces(written(tmp_path, "time,a (N),b (N)\n" + rows(",")), {"normal": 2, "shear": 3}))


def test_grams_force(tmp_path: Path) -> None:
    forces = open_forces(written(tmp_path, "time,normal (gf),shear (kgf)\n" + rows(",")))
    np.testing.assert_allclose(forces.channels["normal"], NORMAL * 9.80665e-3, rtol=1e-8)
    np.testing.assert_allclose(forces.channels["shear"], SHEAR * 9.80665, rtol=1e-7, atol=1e-9)
