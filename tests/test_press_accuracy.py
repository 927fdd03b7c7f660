"""Tests of every quantity of a whole press against its truth: 300 frames/s, noise of 2 grey levels, up to 12 %
divergence.

The press has 300 frames of two 512 x 640 views.
"""

import re
from pathlib import Path

import numpy as np
import pytest
import torch
import xarray as xr

from bench.contact_grid import energy_since_onset
from fingerflow import load_scene, process
from fingerflow.cli.synthetic_recordings import simulate
from fingerflow.ops import green_lagrange, triangle_gradients
from fingerflow.synthetic import Press, Truth
from fingerflow.synthetic.comparison_with_truth import compare

pytestmark = pytest.mark.long  # tests/pipeline/stages/test_reference.py has a small press
ROOT = Path(__file__).resolve().parents[1]
FRAMES = range(36, 300, 12)  # contacts of 8 mm^2 and more


@pytest.fixture(scope="module")
def truth() -> Truth:
    return Press().truth


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> xr.Dataset:
    folder: Path = tmp_path_factory.mktemp("press") / "press"
    simulate("press", folder)
    return process(load_scene(folder / "scene.toml"))


#: Rows of the table in docs/accuracy.md, with the quantities of the demo's table and how many numbers a cell states.
STATED = {
    "position of a point": ("position of a point, last frame",),
    "real contact area": ("real contact area",),
    "gross contact area": ("gross contact area",),
    "axes of its ellipse": ("semi-major axis", "semi-minor axis"),
    "median displacement": ("median displacement",),
    "median divergence": ("median divergence",),
    "median curl": ("median curl",),
    "median strain": ("median strain exx", "median strain eyy", "median strain exy"),
}


def numbers(text: str) -> list[float]:
    """Return the magnitudes of the numbers in a text."""
    return [abs(float(number)) for number in re.findall(r"[-+]?\d+(?:\.\d+)?", text.replace("10 mm²", ""))]


def agree(stated: float, measured: float) -> bool:
    """Return whether a rounded number is the measured one to 10 %, or to half a unit of its second decimal."""
    return abs(stated - measured) <= max(0.1 * measured, 0.05)


def test_pages_state_the_table_of_the_demo(result: xr.Dataset) -> None:
    """README and docs/accuracy.md state the errors that `make demo` prints."""
    rows = {row["quantity"]: numbers(row["error"]) for row in compare(result, Press())}
    page = (ROOT / "docs" / "accuracy.md").read_text(encoding="utf-8")
    for name, quantities in STATED.items():
        cells = next(line for line in page.splitlines() if line.startswith(f"| {name} |")).split("|")[2:4]
        for cell, place in zip(cells, (0, -1), strict=True):
            measured = [rows[quantity][place] for quantity in quantities]
            stated = numbers(cell.partition("(")[0].partition(" of ")[0])
            wanted = measured if len(stated) == len(measured) else [max(measured)]
            assert not stated or all(map(agree, stated, wanted)), (name, stated, measured)
    words = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    sentence = words[words.index("The press of `make demo`") : words.index("A whole recording takes")]
    press = [rows[f"{name} contact area"] for name in ("real", "gross")]
    measured = [rows["position of a point, last frame"][0], *press[0], *press[1], *rows["median divergence"]]
    stated = numbers(sentence.replace(" of 34", ""))
    assert len(stated) == len(measured)
    assert all(map(agree, stated, measured)), (stated, measured)


def test_positions(result: xr.Dataset, truth: Truth) -> None:
    """The RMS error of positions is below 0.03 px in the last frame, after 20 px of motion; without the correction for
    curvature it would be 0.031 px. It is that stated, to a quarter.
    """
    pixels = result["position_px"].values
    assert pixels.shape[1] == 700
    material = truth.material(truth.topography_positions(pixels[0]), 0)
    error = pixels[-1] - truth.topography_pixels(truth.positions(material, 299))
    found = np.isfinite(error).all(-1)
    assert found.mean() > 0.99
    assert np.sqrt((error[found] ** 2).sum(-1).mean()) < 0.03
    assert np.linalg.norm(error[found], axis=-1).max() < 0.15
    for k in (100, 200, 299):
        error = pixels[k] - truth.topography_pixels(truth.positions(material, k))
        ratio = np.sqrt(np.nanmean(error**2) / np.nanmean(result["position_std_px"].values[k] ** 2))
        assert 0.8 < ratio < 1.25, k


def test_medians(result: xr.Dataset, truth: Truth) -> None:
    """The error of the median divergence and curl is below 1 um/mm RMS over the frames and 2.5 in the worst, that of
    strain 2; 1 % of gross contact area moves the median by 2. The errors are below two stated deviations in at least 20
    of 22 frames: 95 % of normal errors are. The parts of gauge length and border are at most 3 um/mm.
    """
    true = [truth.medians(k) for k in FRAMES]
    moved = np.array([(medians.displacement_x, medians.displacement_y) for medians in true])
    error = np.abs(result["global_displacement_vector"].values[FRAMES] - moved)
    assert np.mean(error < 2 * result["global_displacement_vector_std"].values[FRAMES]) >= 0.9
    assert error.max() < 0.006  # three deviations
    for name in ("divergence", "curl"):
        error = 1000 * (result[f"median_{name}"].values[FRAMES] - [getattr(medians, name) for medians in true])
        assert np.sqrt((error**2).mean()) < 1.0, name
        assert np.abs(error).max() < 2.5, name
        assert abs(error[-1]) < 2.0, name
        stated = 1000 * result[f"median_{name}_std"].values[FRAMES]
        assert np.mean(np.abs(error) < 2 * stated) >= 0.9, name
        assert stated.max() < 5, name
    error = 1000 * (result["median_strain"].values[FRAMES] - np.array([(m.exx, m.eyy, m.exy) for m in true]))
    assert np.sqrt((error**2).mean(0)).max() < 1.0
    assert np.abs(error).max() < 2.0


def test_strain_energy(result: xr.Dataset) -> None:
    """The strain energy of all skin in contact has an error of at most 5 %, as stated. A border that is 0.03 mm off
    changes it by 4 %.
    """
    frames = range(60, 300, 24)
    true, _ = np.array([energy_since_onset(Press(), result, k, 0.1) for k in frames]).T
    energy, stated = result["strain_energy"].values[frames], result["strain_energy_std"].values[frames]
    np.testing.assert_allclose(energy, true, rtol=0.05)
    z = (energy - true) / stated
    assert np.sqrt((z**2).mean()) < 1.5
    assert np.abs(z).max() < 3
    assert (stated < 0.15 * energy).all()


def test_strain_energy_between_points(result: xr.Dataset) -> None:
    """The strain energy of the triangles has an error of at most 12 %. Its deviation holds that the border, where most
    of the energy is, is known to 0.06 mm, and what linear triangles lack there: a fifth of a small contact. A fifth of
    the energy of the contact lies outside the triangles, between the outermost points and the border.
    """
    frames = range(84, 300, 36)
    contact, between = np.array([energy_since_onset(Press(), result, k, 0.15) for k in frames]).T
    energy, stated = (result[f"strain_energy_between_points{end}"].values[frames] for end in ("", "_std"))
    np.testing.assert_allclose(energy, between, rtol=0.12)
    z = (energy - between) / stated
    assert np.sqrt((z**2).mean()) < 1.5  # 2.6 if only the errors of the points were stated
    assert (stated < 0.25 * energy).all()
    assert 0.7 < energy[-1] / contact[-1] < 0.9


def test_contact_areas_and_axes(result: xr.Dataset, truth: Truth) -> None:
    """The real area has an error of at most 1 %, gross area and axes of 1.25 % above 40 mm^2. Below, a border along a
    ridge is uncertain by half the distance of ridges (test of the contact graph): at most 4 %, without bias.
    """
    errors = []
    for k in FRAMES:
        expected = truth.real_contact_area_mm2(k)
        assert result["real_contact_area"].values[k] == pytest.approx(expected, rel=0.01 if expected > 5 else 0.02), k
        ellipse = truth.ellipse(k)
        assert ellipse is not None
        limit = 0.0125 if ellipse.area > 40 else 0.04
        errors.append(result["gross_contact_area"].values[k] / ellipse.area - 1)
        assert abs(errors[-1]) < limit, k
        np.testing.assert_allclose(result["ellipse_semi_axes"].values[k], ellipse.semi_axes, rtol=limit, err_msg=str(k))
    assert abs(np.mean(errors)) < 0.01


def test_stated_uncertainty_of_displacements_and_fields(result: xr.Dataset, truth: Truth) -> None:
    """RMS errors of divergence and curl at points, against the true fields, equal the stated deviations within 20 %.

    Those of displacements and of the strain of triangles are 0.65 to 1.4 times theirs. Strain is held to the same
    triangles on true displacements and stated a fourth too large: slim triangles are partly slim by their errors.
    """
    material = truth.material(truth.topography_positions(result["position_px"].values[0]), 0)
    reference = torch.from_numpy(result["reference_position"].values)[None]
    triangles = torch.from_numpy(result["triangles"].values.astype(np.int64))
    squares: dict[str, list[tuple[float, float]]] = {}
    for k in range(60, 300, 24):
        exact, ((xx, xy), (yx, yy)) = truth.displacement(material, k), np.moveaxis(truth.gradient(material, k), 0, -1)
        strain = green_lagrange(triangle_gradients(reference, triangles, torch.from_numpy(exact)[None]))[0].numpy()
        expected = {"displacement": exact, "divergence": xx + yy, "curl": yx - xy, "strain": strain}
        for name, true in expected.items():
            error, stated = result[name].values[k] - true, result[f"{name}_std"].values[k]
            stated = np.broadcast_to(stated[..., None] if error.ndim > stated.ndim else stated, error.shape)
            known = np.isfinite(error / stated)
            squares.setdefault(name, []).append(((error[known] ** 2).sum(), (stated[known] ** 2).sum()))
    for name, pairs in squares.items():
        low, high = (0.8, 1.2) if name in ("divergence", "curl") else (0.65, 1.4)
        assert low < np.sqrt(np.divide(*np.sum(pairs, axis=0))) < high, name
