"""Calibration from image files of the scale ring and the disc target."""

from collections.abc import Mapping
from pathlib import Path

from fingerflow.calibration.calibration import Calibration, is_calibration
from fingerflow.calibration.chessboard import fit_lens
from fingerflow.calibration.edge import Array
from fingerflow.calibration.from_frames import calibrate
from fingerflow.calibration.overlay_image import draw_overlay
from fingerflow.errors import FingerflowError
from fingerflow.recordings import open_recording
from fingerflow.results.atomic_write import keep_others, spare, write_atomically
from fingerflow.schema.views import View

FILE = "calibration.toml"


def calibrate_files(
    ring: Path | str,
    target: Path | str | None = None,
    background: Path | str | None = None,
    views: Mapping[str, View] | None = None,
    hole_radius_mm: float = 2.75,
    output: Path | str = FILE,
    overwrite: bool = False,
    chessboard: Path | str | None = None,
    corners: tuple[int, int] | None = None,
) -> Calibration:
    """Determine image scale and view transform from image files; write a calibration file and an overlay image.

    Args:
        ring: an image, or a recording whose first frame is used; likewise the other two.
        target: with three discs; None for one view, which needs the scale alone.
        background: the empty glass.
        views: parts of a frame with "contact" and, with a target, "topography". The defaults are the right
            and the left half of a frame; without a target the whole frame is "contact".
        hole_radius_mm: of the ring.
        output: the calibration file.
        overwrite: replace a file of that name that is no calibration.
        chessboard: from which the distortion of the lens is measured; None for none.
        corners: numbers of inner corners in a row and in a column of the chessboard.

    Raises:
        FingerflowError: as `calibrate`; a file cannot be read or written, would replace an input, or is not ours.
    """
    output, chosen = Path(output), dict(views or {})
    if target is None and "topography" in chosen:
        raise FingerflowError("a topography view needs a target: without one the calibration is a scale alone")
    counted = corners is not None and len(corners) == 2 and all(3 <= count <= 99 for count in corners)
    if counted != (chessboard is not None):
        raise FingerflowError("chessboard and corners belong together: the frame, and its inner corners, such as 9 6")
    inputs = [None if file is None else Path(file) for file in (ring, target, background, chessboard)]
    ring_frame, target_frame, empty_frame, board = (None if file is None else _first_frame(file) for file in inputs)
    assert ring_frame is not None
    rows, columns = ring_frame.shape
    half = 0 if target is None else columns // 2
    views = {"contact": View((0, rows), (half, columns)), **chosen}
    if target is not None:
        views.setdefault("topography", View((0, rows), (0, half)))
    try:
        if board is not None and board.shape != ring_frame.shape:
            raise FingerflowError("the frame of the chessboard has another size; record all with the same settings")
        lens = None if board is None or corners is None else fit_lens(board, views, corners)
        calibration = calibrate(target_frame, ring_frame, views, hole_radius_mm, empty_frame, lens)
    except FingerflowError as error:
        raise FingerflowError(f"{', '.join(str(file) for file in inputs if file)}: {error}") from None
    picture = output.with_suffix(".png")
    for path in (output, picture):
        spare(path, *inputs)
    keep_others(output, is_calibration, overwrite)
    # The image has no mark of its own: fingerflow wrote it if the file beside it is a calibration.
    keep_others(picture, lambda _: output.exists() and is_calibration(output), overwrite)

    def write_both(part: Path) -> None:
        part.write_text(calibration.to_toml(), encoding="utf-8")
        write_atomically(picture, lambda part: draw_overlay(part, calibration, target_frame, ring_frame))

    # Write both files or neither: once the image is written, only the calibration file remains to be renamed.
    write_atomically(output, write_both)
    return calibration


def _first_frame(path: Path) -> Array:
    with open_recording(path) as recording:
        frame: Array = recording[0]
        if recording.unreadable:
            raise FingerflowError(f"{path}: frame 0 {recording.unreadable[0]}; copy or record it again")
        return frame
