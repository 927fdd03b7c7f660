"""Tests of figure files: formats, width on paper, text kept as text, captions, and lines distinguishable in grey."""

import re
from pathlib import Path

import cv2
import pytest
from matplotlib.figure import Figure

from fingerflow.errors import FingerflowError
from fingerflow.plot.axes_style import figure_style, finished, given_or_new
from fingerflow.plot.figure_files import FigureFiles, settle

MM_PER_POINT = 25.4 / 72


def drawn(title: str = "Contact area") -> Figure:
    axes = given_or_new(None)
    axes.plot([0, 1], [0, 1], label="a")
    axes.set(title=title, xlabel="force (N)", ylabel="area (mm²)")
    figure = finished(axes, "Area against force. n = 2 frames.").get_figure()
    assert isinstance(figure, Figure)
    return figure


@pytest.mark.parametrize(("width", "mm"), [("85mm", 85.0), ("18 cm", 180.0), ("3.5in", 88.9)])
def test_each_format_has_the_width(width: str, mm: float, tmp_path: Path) -> None:
    files = FigureFiles.parse("pdf, svg,PNG", width)
    assert files.width_mm == pytest.approx(mm)
    with figure_style(files.width_mm or 0.0):
        first = files.save(drawn(), tmp_path / "new", "area")
    assert first == tmp_path / "new" / "area.pdf"
    assert sorted(path.name for path in first.parent.iterdir()) == [
        f"area.{one}" for one in ("pdf", "png", "svg", "txt")
    ]
    box = re.search(rb"MediaBox \[ 0 0 ([0-9.]+)", first.read_bytes())
    assert box is not None
    assert float(box[1]) * MM_PER_POINT == pytest.approx(mm, abs=1e-6)
    svg = first.with_suffix(".svg").read_text(encoding="utf-8")
    points = re.search(r'<svg[^>]* width="([0-9.]+)pt"', svg)
    assert points is not None
    assert float(points[1]) * MM_PER_POINT == pytest.approx(mm, abs=1e-5)
    picture = cv2.imread(str(first.with_suffix(".png")))
    assert picture is not None
    assert picture.shape[1] == pytest.approx(mm / 25.4 * 300, abs=1)


def test_text_stays_text(tmp_path: Path) -> None:
    with figure_style():
        pdf = FigureFiles.parse("pdf,svg").save(drawn(), tmp_path, "area").read_bytes()
    assert b"/CIDFontType2" in pdf or b"/TrueType" in pdf  # type 42
    assert b"/Type3" not in pdf
    svg = (tmp_path / "area.svg").read_text(encoding="utf-8")
    assert ">Contact area</text>" in svg
    sizes = [float(size) for size in re.findall(r"font(?:-size)?: ?([0-9.]+)px", svg)]
    assert 7.0 <= min(sizes) <= max(sizes) <= 8.0


def test_the_caption_lies_beside_the_figure_and_both_are_ours(tmp_path: Path) -> None:
    files = FigureFiles()
    with figure_style():
        files.save(drawn(), tmp_path, "area")
    caption = (tmp_path / "area.txt").read_text(encoding="utf-8")
    assert caption == "Area against force. n = 2 frames.\n(written by fingerflow)\n"
    files.keep_others(tmp_path, "area", overwrite=False)
    for suffix in ("png", "txt"):
        (tmp_path / f"notes.{suffix}").write_text("years of work")
        with pytest.raises(FingerflowError, match=rf"notes\.{suffix} exists and was not written by this command"):
            files.keep_others(tmp_path, "notes", overwrite=False)
        (tmp_path / f"notes.{suffix}").unlink()


def test_a_file_is_the_same_each_time(tmp_path: Path) -> None:
    files = FigureFiles.parse("pdf,svg,png")
    for name in ("one", "two"):
        with figure_style():
            files.save(drawn(), tmp_path / name, "area")
    for suffix in files.formats:
        first, second = ((tmp_path / name / f"area.{suffix}").read_bytes() for name in ("one", "two"))
        assert first == second, suffix


@pytest.mark.parametrize(
    ("formats", "width", "message"),
    [
        ("jpg", None, "--format jpg: 'jpg' is none; give one or more of pdf, svg, png, with commas between them"),
        ("pdf,", None, "--format pdf,: '' is none"),
        ("png", "85", "--width 85: give a number and its unit: mm, cm or in, such as 85mm"),
        ("png", "-85mm", "give a number and its unit"),
        ("png", "nan mm", "give a number and its unit"),
        ("png", "8mm", "--width 8mm: give 60 to 400 mm"),
        ("png", "8m", "give a number and its unit"),
        ("png", "85cm", "give 60 to 400 mm"),
    ],
)
def test_wrong_values_are_named(formats: str, width: str | None, message: str) -> None:
    with pytest.raises(FingerflowError, match=re.escape(message)):
        FigureFiles.parse(formats, width)


def test_long_titles_are_broken_at_clauses() -> None:
    with figure_style(60):
        figure = drawn("F(6, 18) = 6.2, p = 0.074, 28 trials of 4 participants")
    settle(figure)
    title = figure.axes[0].title
    assert title.get_text() == "F(6, 18) = 6.2, p = 0.074,\n28 trials of 4 participants"
    assert title.get_window_extent().width <= figure.bbox.width
