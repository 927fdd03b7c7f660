"""Figures of the supplement of Willemet et al. 2021, made from simulations and tables, and a movie of the model."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from fingerflow.plot.figure_files import PNG, FigureFiles
from fingerflow.report.model_movie import write_movie
from fingerflow.report.supplement.of_models import decomposition, half_sphere, strains_at_depth
from fingerflow.report.supplement.of_observer import curl, ideal_observer, individual_performance
from fingerflow.report.supplement.of_trials import (
    displacement_and_angle,
    friction_and_area,
    kinematics,
    strain_energy,
    surface_strain,
)
from fingerflow.report.supplement.sheet import Sheet, SheetPanel
from fingerflow.report.supplement.sources import Sources
from fingerflow.results.atomic_write import is_marked, keep_others

__all__ = ["FIGURES", "Sheet", "SheetPanel", "Sources", "Written", "write_supplement"]

#: Functions that draw the figures from their sources. S2 shows photographs of the setup and S3 frames of a recording,
#: so neither is here.
FIGURES: dict[str, Callable[[Sources], Sheet]] = {
    "S1": friction_and_area,
    "S4": half_sphere,
    "S5": kinematics,
    "S6": decomposition,
    "S7": displacement_and_angle,
    "S8": surface_strain,
    "S9": strain_energy,
    "S10": strains_at_depth,
    "S11": ideal_observer,
    "S12": individual_performance,
    "S13": curl,
}
MOVIE = "M3.mp4"


@dataclass(frozen=True)
class Written:
    """Outcome for one figure (or the movie) of the supplement: name, path (None if nothing could be drawn), and panels
    left out with reasons.
    """

    name: str
    path: Path | None
    left_out: tuple[str, ...]

    def __str__(self) -> str:
        """Return one line of text that states the path and the panels left out."""
        skipped = "; ".join(self.left_out)
        if self.path is None:
            return f"{self.name}: skipped: {skipped}"
        return f"{self.name}: {self.path}" + (f" (without {skipped})" if skipped else "")


def write_supplement(
    sources: Sources, folder: Path, progress: bool = True, overwrite: bool = False, files: FigureFiles = PNG
) -> list[Written]:
    """Write each figure and the movie of the model as `M3.mp4` into a folder, which is created if missing.

    Raises FingerflowError where a file cannot be written or a trace cannot be cut into epochs; and, before anything is
    drawn, where without ``overwrite`` a file of such a name is there that is no such figure.
    """
    for figure in FIGURES:
        files.keep_others(folder, figure, overwrite)
    keep_others(folder / MOVIE, is_marked, overwrite)
    written = []
    with tqdm(FIGURES.items(), desc="figures", disable=not progress, leave=False) as bar:
        for name, make in bar:
            bar.set_postfix_str(name)
            sheet = make(sources)
            path = sheet.write(folder, files) if sheet.panels else None
            written.append(Written(name, path, sheet.left_out))
    movie = write_movie(sources.presses, folder / MOVIE, progress)
    return [*written, Written("M3", movie, ())]
