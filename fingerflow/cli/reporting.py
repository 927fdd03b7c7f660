"""Commands that turn results into pages, figures and verdicts."""

import json
from pathlib import Path
from typing import Annotated

import typer

from fingerflow.cli.app import AsJson, Format, Overwrite, Width, app, figure_files, process_scene, tell
from fingerflow.errors import FingerflowError


@app.command()
def report(
    scene: Annotated[Path, typer.Argument(help="A scene file, or the results folder of a stream.")],
    result: Annotated[Path | None, typer.Option(help="Default result.h5 beside the scene.")] = None,
    friction: Annotated[
        list[float] | None,
        typer.Option(
            help="A coefficient of friction at which the skin chain is pressed with the measured force and drawn "
            "beside the measured contact area and divergence; may be repeated."
        ),
    ] = None,
    chain: Annotated[str, typer.Option(help="That chain's parameters: paper or lab.")] = "paper",
    formats: Format = None,
    width: Width = None,
    overwrite: Overwrite = False,
) -> None:
    """Write report.html and overlay.mp4 of a processed scene, or report.html of a played stream.

    With --format or --width, each figure of the page is also written as a file into the folder figures beside it.
    """
    from fingerflow.report import write_report
    from fingerflow.report.chain_comparison import compare_with_chain
    from fingerflow.results.result import load_result
    from fingerflow.schema.scene import load_scene

    files = figure_files(formats, width) if formats or width else None
    if scene.is_dir():
        from fingerflow.results.stream_result import open_stream

        if result is not None:
            raise FingerflowError(
                f"--result {result}: {scene} is the folder of a stream, which has its own; leave it out"
            )
        if friction:
            raise FingerflowError(f"--friction: {scene} is the folder of a stream, which has no forces to press with")
        typer.echo(f"report: {write_report(open_stream(scene), None, scene, overwrite=overwrite, figure_files=files)}")
        return
    loaded = load_scene(scene)  # loaded first, so that an error in the scene is not reported as an error in the result
    stored = load_result(result or scene.parent / "result.h5")
    beside = compare_with_chain(stored, friction, chain) if friction else None
    page = write_report(stored, loaded, scene.parent, chain=beside, overwrite=overwrite, figure_files=files)
    typer.echo(f"report: {page}")


@app.command("noise-floor")
def noise_floor(
    frames: Annotated[Path, typer.Argument(help="A recording of skin, or of a print, that rests on the glass.")],
    scene: Annotated[Path, typer.Option(help="The scene whose settings apply.")] = Path("scene.toml"),
    as_json: AsJson = False,
) -> None:
    """Measure the noise floors of displacement, divergence and strain in still frames, and print them as the keys
    `rig.*` of a scene file.
    """
    from dataclasses import asdict

    from fingerflow.report.noise_floor import MEASURED, still_scene
    from fingerflow.report.noise_floor import noise_floor as floor_of
    from fingerflow.schema.scene import load_scene
    from fingerflow.schema.toml_value import toml_value
    from fingerflow.schema.variables import VARIABLES

    still = still_scene(load_scene(scene), frames.resolve())
    found = asdict(floor_of(process_scene(still, list(MEASURED), quiet=as_json), still))
    found = {name: value if isinstance(value, int) else float(f"{value:.3g}") for name, value in found.items()}
    lines = [
        f"{name:14}{one.shown_unit.factor * value:.3g} {one.shown_unit.name}"
        for name, value, one in zip(MEASURED, found.values(), map(VARIABLES.__getitem__, MEASURED), strict=False)
    ]
    lines += ["", f"For the report, in {scene}:", "[rig]", f"noise_floor = {toml_value(found)}"]
    tell(found, "\n".join(lines), as_json)


@app.command()
def slip(
    scenes: Annotated[list[Path], typer.Argument(help="Scene files of trials of tangential loading.")],
    figure: Annotated[Path | None, typer.Option(help="A folder for figures: one a trial, and one of all.")] = None,
    formats: Format = None,
    width: Width = None,
    overwrite: Overwrite = False,
) -> None:
    """Classify trials of tangential loading: does the stuck area vanish abruptly or shrink gradually?"""
    from fingerflow.report.slip_trials import SlipTrial, summary, verdict_line, write_figures
    from fingerflow.schema.scene import load_scene

    if figure is None and (formats or width):
        raise FingerflowError("--format and --width are of figures; name a folder for them by --figure")
    files = figure_files(formats, width)
    trials, failed = [], 0
    for path in scenes:
        try:
            result = process_scene(
                load_scene(path), ["stuck_ratio", "stuck_ratio_std", "printed_stuck_ratio"], quiet=True
            )
        except FingerflowError as error:
            failed += 1
            typer.echo(f"{path}: not judged: {error}")
            continue
        trials.append(SlipTrial.of(result, str(path)))
        typer.echo(verdict_line(trials[-1]))
        for warning in json.loads(result.attrs["warnings"]):
            typer.echo(f"warning: {path}: {warning}", err=True)
    typer.echo(summary(trials, failed))
    if figure is not None and trials:
        typer.echo(f"figures: {write_figures(trials, figure, overwrite, files)}")
    if not trials:
        raise typer.Exit(2)


@app.command()
def figures(
    folder: Annotated[Path, typer.Argument(help="Where to write S1.png, S1.txt (the caption), S4.png ... and M3.mp4.")],
    tribometer: Annotated[
        Path | None,
        typer.Option(help="A trace of sliding friction, for figure S1: CSV, HDF5, .mat or .tdms."),
    ] = None,
    column: Annotated[
        list[str] | None,
        typer.Option(
            help="normal=NAME, tangential=NAME, position=NAME, amplitude=NAME or time=NAME: what a column of the trace "
            "is called there; may be repeated."
        ),
    ] = None,
    unit: Annotated[
        list[str] | None,
        typer.Option(help="NAME=UNIT of a column of the trace that does not state it; may be repeated."),
    ] = None,
    trials: Annotated[
        Path | None,
        typer.Option(
            help="A CSV file, one row a trial: participant, trial, condition (vibration amplitude in µm), answer (1 or "
            "0) and any of max_force, time_to_max_force, duration, force_rate, max_displacement, global_displacement, "
            "force_angle, real_contact_area, gross_contact_area, divergence, curl, strain, strain_rate, strain_energy, "
            "strain_energy_rate, in N, s, mm, rad and mJ, strain and divergence without unit; "
            "of any with _difference behind its name, comparison less reference."
        ),
    ] = None,
    yes_no: Annotated[
        bool, typer.Option("--yes-no", help="Fit the guess rate of figure S12 C; 0.5, of a forced choice, without it.")
    ] = False,
    formats: Format = None,
    width: Width = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Draw figures of Willemet et al. 2021 from simulations, a tribometer trace and a table of trials."""
    from fingerflow.models.observer import FORCED_CHOICE, YES_NO
    from fingerflow.report.supplement import Sources, write_supplement
    from fingerflow.report.trials_file import load_trials
    from fingerflow.report.tribometer import read_tribometer

    files = figure_files(formats, width)
    names, units = _pairs("--column", column), _pairs("--unit", unit)
    if tribometer is None and (names or units):
        raise FingerflowError("--column and --unit are of a trace; give the file by --tribometer")
    sources = Sources(
        tribometer=None if tribometer is None else read_tribometer(tribometer, names, units),
        trials=None if trials is None else load_trials(trials),
        design=YES_NO if yes_no else FORCED_CHOICE,
    )
    written = write_supplement(sources, folder, progress=not as_json, overwrite=overwrite, files=files)
    facts = [
        {"figure": one.name, "file": one.path and str(one.path), "left_out": list(one.left_out)} for one in written
    ]
    tell(facts, "\n".join(map(str, written)), as_json)


def _pairs(option: str, given: list[str] | None) -> dict[str, str]:
    pairs = [text.partition("=") for text in given or []]
    for name, equals, value in pairs:
        if not (name and equals and value):
            raise FingerflowError(f"{option} {name}{equals}{value}: give two names with = between them")
    return {name: value for name, _, value in pairs}
