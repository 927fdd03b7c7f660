"""Tests of the page of a result: its content, one self-contained file, and its layout on a phone and in print."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from fingerflow import load_scene, process
from fingerflow.errors import FingerflowError
from fingerflow.plot.figure_files import FigureFiles
from fingerflow.report import write_report
from fingerflow.report.cautions import cautions
from fingerflow.report.key_frames import key_frames
from fingerflow.report.key_numbers import key_numbers
from fingerflow.results.result import save_result
from fingerflow.schema.rounding import format_uncertainty
from fingerflow.schema.scene import Scene
from tests.small_trials import SMALL_PRESS, write_small

Trial = tuple[Scene, xr.Dataset]


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory) -> Trial:
    folder = tmp_path_factory.mktemp("press") / "recording"
    scene = load_scene(write_small(folder, SMALL_PRESS))
    (folder / "calibration.png").write_bytes(b"\x89PNG of a target")
    return scene, process(scene)


@pytest.fixture(scope="module")
def page(trial: Trial, tmp_path_factory: pytest.TempPathFactory) -> Path:
    scene, result = trial
    return write_report(result, scene, tmp_path_factory.mktemp("page"))


def told(page: Path) -> str:
    """Return the text of a page without images, scripts and numbers of curves."""
    text = re.sub(r"base64,[A-Za-z0-9+/=\s]+", "", page.read_text(encoding="utf-8"))
    return re.sub(r"<(script|style)\b.*?</\1>", "", text, flags=re.DOTALL)


def of_frames(count: int, **values: Any) -> xr.Dataset:
    return xr.Dataset(
        {name: (("frame", "xy")[: np.ndim(one)], one) for name, one in values.items()},
        coords={"time": ("frame", np.arange(count) / 100), "frame": np.arange(count)},
        attrs={"warnings": "[]"},
    )


def test_the_page_is_one_file_without_none(page: Path) -> None:
    text = told(page)
    assert "http" not in page.read_text(encoding="utf-8").replace("http-equiv", "").split("base64", 1)[0]
    assert "http" not in text
    for wrong in ("None", "nan", "{&#39;", "{'", "[[", "\u2212"):
        assert wrong not in text, wrong
    assert text.index("Key numbers") < text.index("What was seen") < text.index("Maps on the skin")
    ids = re.findall(r'\bid="([^"]+)"', page.read_text(encoding="utf-8"))
    assert len(ids) == len(set(ids))
    named = re.findall(r'(?:href="|url\()#([^")]+)', page.read_text(encoding="utf-8"))
    assert set(named) <= set(ids)
    assert "<td>rows 0 to 191, columns 240 to 479</td>" in text
    assert (page.parent / "overlay.mp4").exists()


def test_key_numbers_are_those_of_their_frames(trial: Trial, page: Path) -> None:
    _, result = trial
    frames = key_frames(result)
    assert [why for _, why in frames] == ["1 N", "2 N", "3 N", "largest force"]
    force = result["normal_force"].values
    for (frame, _), level in zip(frames, (1, 2, 3), strict=False):
        assert force[frame] >= level > force[frame - 1]
    assert frames[-1][0] == np.nanargmax(force)
    lines = {name: values for name, _, values in key_numbers(result, frames)}
    for k, (frame, _) in enumerate(frames):
        value, spread = (1000 * float(result[f"median_divergence{of}"][frame]) for of in ("", "_std"))
        assert lines["median divergence"][k] == format_uncertainty(value, spread)
        assert lines["median divergence"][k] in told(page)
    assert "a border 0.014 mm off" in told(page)
    for name in ("gross contact area", "real contact area", "contact area ratio"):
        area, spread = (float(result[name.replace(" ", "_") + of][frames[-1][0]]) for of in ("", "_std"))
        assert lines[name][-1] == format_uncertainty(area, spread)


def test_frames_are_chosen_by_what_happens() -> None:
    time = np.linspace(0, 1, 100)
    area = np.full(100, 40.0)
    normal = np.full(100, 2.0)
    ratio = np.where(time < 0.4, time / 0.4, 0.6)
    slide = of_frames(100, gross_contact_area=area, normal_force=normal, load_ratio=ratio)
    found = {why: frame for frame, why in key_frames(slide)}
    assert found["largest T/N"] == np.argmax(ratio)
    assert found["half of the largest T/N"] == np.argmax(ratio >= ratio.max() / 2)
    assert found["last frame"] == 99
    grown = 40 * np.sin(np.pi * time)
    found = {why: frame for frame, why in key_frames(of_frames(100, gross_contact_area=grown))}
    assert found["half of the largest contact"] == np.argmax(grown >= grown.max() / 2)
    assert found["largest contact"] == np.argmax(grown)
    weak = of_frames(100, gross_contact_area=area, normal_force=0.5 * time)
    assert [why for _, why in key_frames(weak)] == ["0.125 N", "0.25 N", "0.375 N", "largest force"]
    assert key_frames(of_frames(100, gross_contact_area=np.full(100, np.nan), normal_force=normal)) == []


def test_a_trial_in_which_every_frame_is_bad(trial: Trial, tmp_path: Path) -> None:
    scene, result = trial
    each = {name: one for name, one in result.data_vars.items() if "frame" in one.dims}
    floats = {name: one * np.nan for name, one in each.items() if one.dtype.kind == "f"}
    bad = result.assign(floats).assign(frame_status=result["frame_status"] * 0 + 3)
    text = told(write_report(bad, scene, tmp_path))
    assert "No frame of this recording can be used" in text
    assert "Key numbers" not in text
    assert "nan" not in text
    assert "Calibration" in text


def test_strain_that_no_skin_has_is_said(trial: Trial) -> None:
    _, result = trial
    assert not any("no skin is" in one for one in cautions(result))
    torn = result["strain"].copy()
    torn[9:, ::20] = 3.0
    (said,) = [one for one in cautions(result.assign(strain=torn)) if "no skin is" in one]
    assert said.startswith("In frame 9 and later")


@pytest.mark.long
def test_commands_take_a_scene_or_its_result(
    trial: Trial, command: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, result = trial
    save_result(result[["normal_force", "gross_contact_area"]], tmp_path / "other.h5")
    save_result(result, scene.path.parent / "result.h5")
    for source in (tmp_path / "other.h5", scene.path):
        assert command("export-table", source, tmp_path / "table.csv") == 0
        assert command("process", source, "-v", "normal_force", "-o", tmp_path / "forces.h5") == 0
    assert command("export-map", scene.path, "divergence", tmp_path / "map.csv") == 0
    assert command("report", tmp_path / "other.h5") == 0
    assert "Key numbers" in told(tmp_path / "report.html")
    (tmp_path / "other.h5").write_bytes(b"damaged")
    capsys.readouterr()
    assert command("report", tmp_path / "other.h5") == 2
    assert "UTF-8" not in capsys.readouterr().err


def test_the_page_in_a_browser(trial: Trial, page: Path, browser: Any) -> None:
    """The page makes no network request, no line is wider than a phone, and the cursor reads out the values of the
    result.
    """
    _, result = trial
    asked: list[str] = []
    wrong: list[str] = []
    for width, media in ((1200, "screen"), (390, "screen"), (718, "print")):
        view = browser.new_page(viewport={"width": width, "height": 800})
        view.on("request", lambda one: asked.append(one.url))
        view.on("pageerror", lambda one: wrong.append(str(one)))
        view.emulate_media(media=media)
        view.goto(page.as_uri())
        assert view.evaluate("document.documentElement.scrollWidth") <= width
        hidden = view.evaluate("[...document.querySelectorAll('.tabs > section')].filter(e => !e.offsetHeight).length")
        assert (hidden == 0) == (media == "print")  # all tabs are printed
        if media == "screen":
            figure = view.locator("figure[data-figure='gross_contact_area-normal_force']")
            figure.focus()
            for _ in range(13):
                view.keyboard.press("ArrowRight")
            gross, real = (float(result[name][12]) for name in ("gross_contact_area", "real_contact_area"))
            said = figure.locator("output").inner_text()
            assert said.startswith("frame 12, normal force (N)")
            numbers = [float(one) for one in re.findall(r"(?:gross|real) ([0-9.]+) mm²", said)]
            np.testing.assert_allclose(numbers, [gross, real], rtol=1e-3)
            # The other figures show the values of the same frame.
            other = view.locator("figure[data-figure='median_divergence-normal_force'] output").inner_text()
            assert float(re.findall(r"divergence ([-0-9.]+) µm/mm", other)[0]) == pytest.approx(
                1000 * float(result["median_divergence"][12]), rel=1e-3
            )
            box = figure.locator("svg").bounding_box()
            view.mouse.move(box["x"] + 0.97 * box["width"], box["y"] + box["height"] / 2)
            assert figure.locator("output").inner_text().startswith("frame 15")
            view.locator("label", has_text="against time (s)").first.click()
            assert view.locator("figure[data-figure='gross_contact_area-time']").is_visible()
        view.close()
    assert not wrong
    assert {one.split(":")[0] for one in asked} <= {"file", "data"}


@pytest.mark.long
def test_figures_of_the_page_are_written_as_files_with_their_captions(trial: Trial, tmp_path: Path) -> None:
    scene, result = trial
    files = FigureFiles(("svg",), 120.0)
    text = told(write_report(result, scene, tmp_path, brief=True, figure_files=files))
    folder = tmp_path / "figures"
    names = {path.stem for path in folder.glob("*.svg")}
    assert {"gross_contact_area-normal_force", "map-divergence-15", "picture-contact-15", "normal_force"} <= names
    assert names == {path.stem for path in folder.glob("*.txt")}
    assert text.count("<figcaption>") == len(names)
    caption = (folder / "median_divergence-normal_force.txt").read_text(encoding="utf-8")
    assert "Bands: ± 2 standard deviations, by the errors of the points, " in caption.replace("\n", " ")
    known = int(np.isfinite(result["median_divergence"]).sum())
    assert f"n = {known} frames." in caption
    assert f"n = {known} frames.</figcaption>" in text
    (folder / "normal_force.svg").write_text("years of work")
    with pytest.raises(FingerflowError, match=r"normal_force\.svg exists and was not written"):
        write_report(result, scene, tmp_path, brief=True, figure_files=files)
