"""The command line: one command a function, no logic."""

import json
import shutil
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from fingerflow.errors import FingerflowError
from fingerflow.study.commands import app as study

app = typer.Typer(
    help="Contact area, skin motion and strain from recordings of a fingertip on glass.",
    no_args_is_help=True,
    add_completion=False,
)
app.add_typer(study, name="study")
_DEMO_FILES = {
    *("scene.toml", "frames.npy", "empty.npy", "dark.npy", "forces.csv", "truth.json"),
    *("result.h5", "report.html", "overlay.mp4"),
}
_INTERRUPTED = 130  # exit status, as shells have it for SIGINT
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for machines, and no progress bar.")]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace a file that this command has not written; never an input.")
]
PixelRanges = tuple[int, int, int, int]
Outputs = Annotated[
    list[str] | None, typer.Option("--output", help="A variable that is wanted; may be repeated. Default: all.")
]


def _tell_version(wanted: bool) -> None:
    if wanted:
        from fingerflow import __version__

        typer.echo(f"fingerflow {__version__}")
        raise typer.Exit


@app.callback()
def _of_all(
    version: Annotated[
        bool, typer.Option("--version", callback=_tell_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@app.command()
def demo(
    folder: Annotated[Path, typer.Argument(help="Where to write.")] = Path("fingerflow-demo"), as_json: AsJson = False
) -> None:
    """Simulate a press, process it, and compare with its known truth."""
    from fingerflow.comparison import as_text, compare
    from fingerflow.report import write_report
    from fingerflow.result import save_result
    from fingerflow.scene import load_scene
    from fingerflow.synthetic import rebuild_scene

    if folder.exists():
        _remove_demo(folder)
    _simulate("press", folder)
    scene = load_scene(folder / "scene.toml")
    result = _process(scene, None, quiet=as_json)
    save_result(result, folder / "result.h5")
    rows = compare(result, rebuild_scene(folder))
    report = write_report(result, scene, folder, rows)
    if as_json:
        _print_json({"report": str(report), "comparison": [row._asdict() for row in rows]})
    else:
        typer.echo(f"{as_text(rows)}\n\nresult: {folder / 'result.h5'}\nreport: {report}")


@app.command()
def init(
    path: Annotated[Path, typer.Argument(help="The scene file to write.")] = Path("scene.toml"),
    gel: Annotated[Path | None, typer.Option(help="Recording of a soft sensor with printed markers.")] = None,
    mm_per_px: Annotated[float | None, typer.Option(help="Scale on the gel, with --gel.")] = None,
) -> None:
    """Write a commented scene file: to fill in, or with --gel one that can be processed as it is."""
    from fingerflow.atomic_write import write_atomically
    from fingerflow.recordings import open_recording
    from fingerflow.scene import gel_scene_text, scene_text

    if path.exists():
        raise FingerflowError(f"{path} exists already; name another file or remove it")
    if (gel is None) != (mm_per_px is None):
        raise FingerflowError("--gel and --mm-per-px belong together: the recording, and how many mm of gel a px shows")
    if gel is None or mm_per_px is None:
        text = scene_text()
    else:
        with open_recording(gel) as recording:
            text = gel_scene_text(gel.resolve().as_posix(), recording.frame_shape, mm_per_px)
    write_atomically(path, lambda part: part.write_text(text, encoding="utf-8"))
    typer.echo(f"{path} was written; {'' if gel else 'fill it in, '}then: fingerflow process {path}")


@app.command()
def info(recording: Path, as_json: AsJson = False) -> None:
    """Say what a recording holds, without reading its frames: damage that only decoding shows is not among it."""
    from fingerflow.recordings import open_recording

    found = open_recording(recording)
    facts = {
        "path": str(found.path),
        "frames": len(found),
        "rows": found.frame_shape[0],
        "columns": found.frame_shape[1],
        "bit_depth": found.bit_depth,
        "dtype": str(found.dtype),
        "frame_rate_hz": found.frame_rate,
        "first_time_s": None if found.times is None or not len(found) else float(found.times[0]),
        "lossy_codec": found.lossy,
        "unreadable": {str(index): reason for index, reason in found.unreadable.items()},
        "warnings": list(found.warnings),
    }
    if as_json:
        _print_json(facts)
    else:
        typer.echo("\n".join(f"{name:14} {value}" for name, value in facts.items()))


@app.command()
def calibrate(
    ring: Annotated[Path, typer.Option(help="Frame of the ring that gives the scale.")],
    target: Annotated[Path | None, typer.Option(help="Frame of the target with three discs, for two views.")] = None,
    background: Annotated[Path | None, typer.Option(help="Frame of the empty glass.")] = None,
    contact: Annotated[
        PixelRanges | None,
        typer.Option(
            help="Where the contact view lies in a frame: first row, end of rows, first column, end of columns. "
            "Default: the right half, or the whole frame without a target."
        ),
    ] = None,
    topography: Annotated[
        PixelRanges | None, typer.Option(help="The same for the topography view. Default: the left half.")
    ] = None,
    hole_radius_mm: Annotated[float, typer.Option(help="Radius of the ring's hole.")] = 2.75,
    output: Annotated[Path, typer.Option(help="Calibration file to write; a picture is written beside it.")] = Path(
        "calibration.toml"
    ),
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Find scale and view-to-view transform from frames of a ring and of a target with discs."""
    from fingerflow import calibration
    from fingerflow.atomic_write import keep_others, spare, write_atomically

    ring_frame = _first_frame(ring)
    target_frame = None if target is None else _first_frame(target)
    empty_frame = None if background is None else _first_frame(background)
    views = _views(ring_frame.shape, contact, topography, both=target is not None)
    found = calibration.calibrate(target_frame, ring_frame, views, hole_radius_mm, empty_frame)
    picture = output.with_suffix(".png")
    spare(output, ring, target, background)
    spare(picture, ring, target, background)
    keep_others(output, calibration.is_calibration, overwrite)
    # The picture has no mark of its own: it is ours where the file beside it is.
    keep_others(picture, lambda _: output.exists() and calibration.is_calibration(output), overwrite)

    def write_both(part: Path) -> None:
        part.write_text(found.to_toml(), encoding="utf-8")
        write_atomically(picture, lambda part: calibration.draw_overlay(part, found, target_frame, ring_frame))

    # Both or none: nothing but a renaming is left when the picture is there.
    write_atomically(output, write_both)
    facts: dict[str, Any] = {
        "mm_per_px": found.mm_per_px,
        "hole_radius_px": found.hole.radius_px,
        "affine": None if found.affine is None else found.affine.matrix.tolist(),
        "similarity_rms_px": None if found.similarity is None else found.similarity.rms_px,
        "warnings": list(found.warnings),
        "calibration": str(output),
        "picture": str(picture),
    }
    if as_json:
        _print_json(facts)
    else:
        typer.echo("\n".join(f"{name:18} {value}" for name, value in facts.items()))


@app.command()
def simulate(
    kind: Annotated[
        str,
        typer.Argument(help="press, chain-press (skin moves as a skin chain under friction), slide or partial-slip"),
    ],
    folder: Path,
    skin: Annotated[
        str | None,
        typer.Option(
            help="loop, whorl or arch: a fingerprint with minutiae and pores, whose ridges break at the border of the "
            "contact. Default: even rings of ridges, whole up to the border."
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            "--print",
            help="A picture of a fingerprint, dark ridges on bright glass, as the skin. Where it is blank, and beyond "
            "it, the skin is smooth and never touches. It is copied into the folder: the truth needs it.",
        ),
    ] = None,
    dpi: Annotated[float | None, typer.Option(help="Pixels an inch of that picture. Default: 500.")] = None,
    friction: Annotated[float | None, typer.Option(help="Coefficient of a chain-press. Default: 0.2.")] = None,
) -> None:
    """Write a synthetic recording with known truth, and a scene file for it."""
    _simulate(kind, folder, skin, picture, dpi, friction)
    typer.echo(f"{folder} was written; process it with: fingerflow process {folder / 'scene.toml'}")


@app.command()
def process(
    scene: Path,
    outputs: Outputs = None,
    to: Annotated[Path | None, typer.Option(help="Result file; default result.h5 beside the scene.")] = None,
    device: Annotated[str, typer.Option(help="auto, cpu, cuda ...")] = "auto",
    engine: Annotated[str, typer.Option(help="torch, or onnx: the graphs of a bundle, by ONNX Runtime.")] = "torch",
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Compute a scene and save the result."""
    from fingerflow.scene import load_scene

    path = to or scene.parent / "result.h5"
    loaded = load_scene(scene)
    result = _process(loaded, outputs, quiet=as_json, device=device, engine=engine, to=path, overwrite=overwrite)
    if as_json:
        _print_json(
            {
                "result": str(path),
                "variables": sorted(map(str, result.data_vars)),
                "warnings": json.loads(result.attrs["warnings"]),
            }
        )
    else:
        for warning in json.loads(result.attrs["warnings"]):
            typer.echo(f"warning: {warning}", err=True)
        typer.echo(f"result: {path}")


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
) -> None:
    """Write report.html and overlay.mp4 of a processed scene, or report.html of a played stream."""
    from fingerflow.report import write_report
    from fingerflow.report.beside_chain import compare_with_chain
    from fingerflow.result import load_result
    from fingerflow.scene import load_scene

    if scene.is_dir():
        from fingerflow.stream_result import open_stream

        if result is not None:
            raise FingerflowError(
                f"--result {result}: {scene} is the folder of a stream, which has its own; leave it out"
            )
        if friction:
            raise FingerflowError(f"--friction: {scene} is the folder of a stream, which has no forces to press with")
        typer.echo(f"report: {write_report(open_stream(scene), None, scene)}")
        return
    loaded = load_scene(scene)  # first: what is wrong with it is not the result's fault
    stored = load_result(result or scene.parent / "result.h5")
    beside = compare_with_chain(stored, friction, chain) if friction else None
    typer.echo(f"report: {write_report(stored, loaded, scene.parent, chain=beside)}")


@app.command()
def slip(
    scenes: Annotated[list[Path], typer.Argument(help="Scene files of trials of tangential loading.")],
    figure: Annotated[Path | None, typer.Option(help="A folder for figures: one a trial, and one of all.")] = None,
) -> None:
    """Judge whether the stuck area of each trial vanishes abruptly or fades."""
    from fingerflow.report.slip_trials import SlipTrial, summary, verdict_line, write_figures
    from fingerflow.scene import load_scene

    trials, failed = [], 0
    for path in scenes:
        try:
            result = _process(load_scene(path), ["stuck_ratio"], quiet=True)
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
        typer.echo(f"figures: {write_figures(trials, figure)}")
    if not trials:
        raise typer.Exit(2)


@app.command()
def figures(
    folder: Annotated[Path, typer.Argument(help="Where to write S1.png, S4.png ... and M3.mp4.")],
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
    as_json: AsJson = False,
) -> None:
    """Draw the figures of Willemet et al. 2021 that simulation, a tribometer trace and a table of trials give."""
    from fingerflow.report.supplement import Sources, write_supplement
    from fingerflow.report.trials_file import load_trials
    from fingerflow.report.tribometer import read_tribometer

    names, units = _pairs("--column", column), _pairs("--unit", unit)
    if tribometer is None and (names or units):
        raise FingerflowError("--column and --unit are of a trace; give the file by --tribometer")
    sources = Sources(
        tribometer=None if tribometer is None else read_tribometer(tribometer, names, units),
        trials=None if trials is None else load_trials(trials),
    )
    written = write_supplement(sources, folder, progress=not as_json)
    if as_json:
        _print_json(
            [
                {"figure": one.name, "file": one.path and str(one.path), "left_out": list(one.left_out)}
                for one in written
            ]
        )
    else:
        typer.echo("\n".join(map(str, written)))


@app.command()
def export(
    recipe: Annotated[Path, typer.Argument(help="A recipe file, such as export/exact.toml.")],
    bundle: Annotated[Path, typer.Option("--output", "-o", help="The folder to write.")],
    as_json: AsJson = False,
) -> None:
    """Write the graphs of a recipe as ONNX, with a player, and compare them with torch."""
    from fingerflow.export import as_text, export_bundle

    rows = export_bundle(recipe, bundle, progress=not as_json)
    if as_json:
        _print_json({"bundle": str(bundle), "differences": [row._asdict() for row in rows]})
    else:
        typer.echo(f"{as_text(rows)}\n\nbundle: {bundle}")


@app.command(
    add_help_option=False,  # the player answers --help itself
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True},
)
def stream(context: typer.Context) -> None:
    """Play an exported bundle on a camera, a recording or a synthetic stream: fingerflow stream BUNDLE --help."""
    from fingerflow.player import main as play

    raise typer.Exit(play(context.args, prog="fingerflow stream"))


@app.command("export-table")
def export_table(
    result: Annotated[Path, typer.Argument(help="A result file, or the results folder of a stream.")],
    table: Annotated[Path, typer.Argument(help="A .csv or .mat file.")],
) -> None:
    """Write a result as CSV (one row a frame) or .mat (everything)."""
    if result.is_dir() and table.suffix == ".csv":
        _export_stream(result, table)
        return
    from fingerflow import result as results
    from fingerflow.stream_result import open_stream

    if table.exists() and not _is_table(table):
        raise FingerflowError(f"{table} exists and was not written by export-table; give another name or remove it")
    results.export_table(open_stream(result) if result.is_dir() else results.load_result(result), table)
    typer.echo(f"{table} was written")


def _export_stream(folder: Path, table: Path) -> None:
    """The player's own table has the same columns, and needs no torch."""
    from fingerflow.player import PlayerError, write_table

    try:
        write_table(folder, table)
    except PlayerError as error:
        raise FingerflowError(str(error)) from None
    typer.echo(f"{table} was written")


def _pairs(option: str, given: list[str] | None) -> dict[str, str]:
    pairs = [text.partition("=") for text in given or []]
    for name, equals, value in pairs:
        if not (name and equals and value):
            raise FingerflowError(f"{option} {name}{equals}{value}: give two names with = between them")
    return {name: value for name, _, value in pairs}


def _is_table(path: Path) -> bool:
    """Whether a file is what export-table writes: a .mat file of a result, or a .csv that begins with its frames."""
    with path.open("rb") as file:
        return file.read(6) in (b"MATLAB", b"frame,")


def _remove_demo(folder: Path) -> None:
    """Removes what an earlier demo wrote; raises FingerflowError, and removes nothing, where anything else is there."""
    strange = sorted(path.name for path in folder.iterdir() if path.name not in _DEMO_FILES)
    if strange or not (folder / "truth.json").exists():
        found = f"holds {', '.join(strange[:3])}" if strange else "is no earlier demo"
        raise FingerflowError(f"{folder} exists and {found}; give another folder, or remove it")
    shutil.rmtree(folder)


def main() -> None:
    """Entry point: 0 done, 2 something the user can put right, 130 interrupted."""
    try:
        # Commands return nothing; typer returns the code of an exit, 130 where it caught the interrupt itself.
        code = app(standalone_mode=False) or 0
    except FingerflowError as error:
        typer.echo(f"fingerflow: {error}", err=True)
        sys.exit(2)
    except (KeyboardInterrupt, typer.Abort):
        code = _INTERRUPTED
    except Exception as error:
        # Wrong usage: typer's own message, with the place in the command line.
        if hasattr(error, "show") and hasattr(error, "exit_code"):
            error.show()
            sys.exit(error.exit_code)
        raise
    if code == _INTERRUPTED:
        typer.echo("fingerflow: interrupted; nothing was left half-written", err=True)
    sys.exit(code)


def _simulate(
    kind: str,
    folder: Path,
    skin: str | None = None,
    picture: Path | None = None,
    dpi: float | None = None,
    friction: float | None = None,
) -> None:
    from dataclasses import replace

    from fingerflow.synthetic import (
        ChainPress,
        FingerprintTexture,
        PartialSlip,
        Press,
        Scene,
        Slide,
        scene_of_print,
        write_recording,
    )

    kinds: dict[str, type[Scene]] = {
        "press": Press,
        "chain-press": ChainPress,
        "slide": Slide,
        "partial-slip": PartialSlip,
    }
    if kind not in kinds:
        raise FingerflowError(f"{kind!r} cannot be simulated; choose one of {', '.join(kinds)}")
    if skin is not None and picture is not None:
        raise FingerflowError("--skin and --print are two skins; give one of them")
    if dpi is not None and picture is None:
        raise FingerflowError("--dpi is the resolution of a picture; give the picture by --print")
    if picture is not None:
        scene = scene_of_print(kinds[kind], picture, **({} if dpi is None else {"dpi": dpi}))
    else:
        scene = kinds[kind]() if skin is None else kinds[kind](texture=FingerprintTexture(pattern=skin))
    if friction is not None:
        if not isinstance(scene, ChainPress):
            raise FingerflowError(f"--friction {friction:g} is of a chain-press; a {kind} has none that moves its skin")
        if not 0 <= friction < float("inf"):
            raise FingerflowError(f"--friction {friction:g}: a coefficient is 0 or more")
        scene = replace(scene, friction=friction)
    write_recording(folder, scene)


def _first_frame(path: Path) -> Any:
    from fingerflow.recordings import open_recording

    with open_recording(path) as recording:
        if not len(recording):
            raise FingerflowError(f"{path} has no frame; one is needed")
        frame = recording[0]
        if recording.unreadable:
            raise FingerflowError(f"{path}: frame 0 {recording.unreadable[0]}; copy it again, or record it anew")
        return frame


def _views(
    shape: tuple[int, int], contact: PixelRanges | None, topography: PixelRanges | None, both: bool
) -> dict[str, Any]:
    """The views of calibration frames: as given, or the halves of a frame, or the whole one."""
    from fingerflow.views import View

    rows, columns = shape
    half = columns // 2 if both else 0
    chosen = {"contact": contact or (0, rows, half, columns)}
    if both:
        chosen["topography"] = topography or (0, rows, 0, half)
    elif topography is not None:
        raise FingerflowError("--topography needs --target: without one the calibration is a scale alone")
    return {name: View(ranges[:2], ranges[2:]) for name, ranges in chosen.items()}


def _process(scene: Any, outputs: list[str] | None, quiet: bool, **options: Any) -> Any:
    from fingerflow.pipeline import process as run

    return run(scene, outputs, progress=not quiet, **options)


def _print_json(facts: Any) -> None:
    typer.echo(json.dumps(facts, indent=1))
