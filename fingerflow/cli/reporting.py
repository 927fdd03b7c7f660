"""Commands that turn results into pages, figures and verdicts."""

import json
from pathlib import Path
from typing import Annotated

import typer

from fingerflow.cli.app import AsJson, Format, Overwrite, Width, app, figure_files, result_in, run_scene, scene_in, tell
from fingerflow.errors import FingerflowError


@app.command()
def report(
    scene: Annotated[Path, typer.Argument(help="A scene file, a result, or the results folder of a stream.")],
    result: Annotated[Path | None, typer.Option(help="Default result.h5 beside the scene.")] = None,
    formats: Format = None,
    width: Width = None,
    overwrite: Overwrite = False,
) -> None:
    """Write report.html and overlay.mp4 of a processed scene, or report.html of a played stream, beside it.

    With --format or --width, each figure of the page is also written as a file into the folder figures beside it.
    """
    from fingerflow.report import write_report

    files = figure_files(formats, width) if formats or width else None
    if scene.is_dir() and result is not None:
        raise FingerflowError(f"--result {result}: {scene} is the folder of a stream, which has its own; leave it out")
    # The scene is loaded first, so that an error in it is not reported as an error in the result.
    loaded, folder = (None, scene) if scene.is_dir() else (scene_in(scene), scene.parent)
    page = write_report(result_in(result or scene), loaded, folder, overwrite=overwrite, figure_files=files)
    typer.echo(f"report: {page}")


@app.command("noise-floor")
def noise_floor(
    frames: Annotated[Path, typer.Argument(help="A recording of skin, or of a print, that rests on the glass.")],
    scene: Annotated[Path, typer.Option(help="The scene or result whose settings apply.")] = Path("scene.toml"),
    as_json: AsJson = False,
) -> None:
    """Measure the noise floors of displacement, divergence and strain in still frames, and print them as the keys
    `rig.*` of a scene file.
    """
    from dataclasses import asdict

    from fingerflow.report.noise_floor import MEASURED, moved, still_scene
    from fingerflow.report.noise_floor import noise_floor as floor_of
    from fingerflow.schema.toml_value import toml_value
    from fingerflow.schema.variables import VARIABLES

    settings = scene_in(scene)
    still = still_scene(settings, frames.resolve())
    measured = run_scene(still, [*MEASURED, "displacement_std"], quiet=as_json)
    floor = floor_of(measured, still)
    for warning in moved(measured, floor):
        typer.echo(f"warning: {frames}: {warning}", err=True)
    floors = asdict(floor)
    floors = {name: value if isinstance(value, int) else float(f"{value:.3g}") for name, value in floors.items()}
    lines = [
        f"{name:14}{variable.shown_unit.factor * value:.3g} {variable.shown_unit.name}"
        for name, value, variable in zip(MEASURED, floors.values(), map(VARIABLES.__getitem__, MEASURED), strict=False)
    ]
    lines += ["", f"For the report, in the scene file {settings.path}:", "[rig]", f"noise_floor = {toml_value(floors)}"]
    tell(floors, "\n".join(lines), as_json)


@app.command()
def slip(
    scenes: Annotated[list[Path], typer.Argument(help="Scene files or results of trials of tangential loading.")],
    figure: Annotated[Path | None, typer.Option(help="A folder for figures: one a trial, and one of all.")] = None,
    formats: Format = None,
    width: Width = None,
    overwrite: Overwrite = False,
) -> None:
    """Classify trials of tangential loading: does the stuck area vanish abruptly or shrink gradually?"""
    from fingerflow.report.slip_trials import SlipTrial, summary, verdict_line, write_figures
    from fingerflow.results.result import is_result, load_result

    if figure is None and (formats or width):
        raise FingerflowError("--format and --width are of figures; name a folder for them by --figure")
    files = figure_files(formats, width)
    trials, failed = [], 0
    for path in scenes:
        try:
            result = load_result(path) if is_result(path) else None
            if result is None or "stuck_ratio" not in result:
                names = ["stuck_ratio", "stuck_ratio_std", "printed_stuck_ratio"]
                result = run_scene(scene_in(path), names, quiet=True)
        except FingerflowError as error:
            failed += 1
            typer.echo(f"{path}: not judged: {error}")
            continue
        trials.append(SlipTrial.read(result, str(path)))
        typer.echo(verdict_line(trials[-1]))
        for warning in json.loads(result.attrs["warnings"]):
            typer.echo(f"warning: {path}: {warning}", err=True)
    typer.echo(summary(trials, failed))
    if figure is not None and trials:
        typer.echo(f"figures: {write_figures(trials, figure, overwrite, files)}")
    if not trials:
        raise typer.Exit(2)
