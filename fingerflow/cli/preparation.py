"""Commands that prepare a scene: `init`, `keys`, `info` and `calibrate`."""

from pathlib import Path
from typing import Annotated

import typer

from fingerflow.cli.app import AsJson, Overwrite, app, tell_facts
from fingerflow.errors import FingerflowError


@app.command()
def init(path: Annotated[Path, typer.Argument(help="The scene file to write.")] = Path("scene.toml")) -> None:
    """Write a commented scene file: a template to fill in."""
    from fingerflow.results.atomic_write import write_text
    from fingerflow.schema.scene_template import scene_text

    if path.exists():
        raise FingerflowError(f"{path} exists already; name another file or remove it")
    write_text(path, scene_text())
    typer.echo(f'{path} was written; fill it in, then: fingerflow process "{path}"')


@app.command()
def keys(
    names: Annotated[list[str] | None, typer.Argument(help="Of keys, or parts of names. Default: all.")] = None,
) -> None:
    """List the keys of scene files: type and range, default and meaning of each."""
    from fingerflow.schema.key_list import as_text, key_list

    rows = {key: row for key, row in key_list().items() if not names or any(name in key for name in names)}
    if not rows:
        raise FingerflowError(f"no key is called {' or '.join(names or ())}; `fingerflow keys` lists all")
    typer.echo("\n".join(as_text(*row) for row in rows.items()))


@app.command()
def info(
    recording: Annotated[Path, typer.Argument(help="A recording, or a force file.")], as_json: AsJson = False
) -> None:
    """Print the properties of a recording or of a force file.

    Frames are not decoded, so damage in their pixels is not detected.
    """
    from fingerflow.recordings import force_facts, holds_forces, open_recording

    if holds_forces(recording):
        forces = force_facts(recording)
        columns = {} if as_json else {f"column {name}": column for name, column in forces.pop("columns").items()}
        return tell_facts(forces | columns, as_json)
    frames = open_recording(recording)
    facts = {
        "path": str(frames.path),
        "frames": len(frames),
        "rows": frames.frame_shape[0],
        "columns": frames.frame_shape[1],
        "bit_depth": frames.bit_depth,
        "dtype": str(frames.dtype),
        "frame_rate_hz": frames.frame_rate,
        "first_time_s": None if frames.times is None or not len(frames) else float(frames.times[0]),
        "lossy_codec": frames.lossy,
        "unreadable": {str(index): reason for index, reason in frames.unreadable.items()},
        "warnings": list(frames.warnings),
    }
    tell_facts(facts, as_json)


PixelRanges = tuple[int, int, int, int]


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
    chessboard: Annotated[
        Path | None, typer.Option(help="Frame of a chessboard flat on the glass, for the distortion of the lens.")
    ] = None,
    corners: Annotated[
        tuple[int, int] | None, typer.Option(help="Inner corners in a row and in a column of the chessboard.")
    ] = None,
) -> None:
    """Measure the image scale and the transform between views from frames of a ring and of a target with discs, and the
    distortion of the lens from a chessboard.
    """
    from fingerflow.calibration import calibrate_files
    from fingerflow.schema.rounding import format_uncertainty
    from fingerflow.schema.views import View

    ranges = {"contact": contact, "topography": topography}
    views = {name: View(pixels[:2], pixels[2:]) for name, pixels in ranges.items() if pixels is not None}
    calibration = calibrate_files(
        ring, target, background, views, hole_radius_mm, output, overwrite, chessboard, corners
    )
    scale = calibration.mm_per_px, calibration.mm_per_px_std
    facts = {
        "mm_per_px": scale[0] if as_json else format_uncertainty(*scale),
        "mm_per_px_std": scale[1],
        "hole_radius_px": calibration.hole.radius_px,
        "affine": None if calibration.affine is None else calibration.affine.matrix.tolist(),
        "similarity_rms_px": None if calibration.similarity is None else calibration.similarity.rms_px,
        "distortion": None if calibration.lens is None else list(calibration.lens.distortion),
        "warnings": list(calibration.warnings),
        "calibration": str(output),
        "picture": str(output.with_suffix(".png")),
    }
    tell_facts(facts, as_json)
