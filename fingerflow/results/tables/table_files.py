"""Export of tables and maps to files; the file suffix selects the format."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy.io
import tifffile
import xarray as xr

from fingerflow.errors import FingerflowError
from fingerflow.results.atomic_write import keep_others, write_atomically, write_csv
from fingerflow.results.tables.archives import is_nwb_result, is_zarr_result, save_nwb, save_zarr
from fingerflow.results.tables.columns import frame_table, point_table, track_table
from fingerflow.results.tables.grid_maps import ORIGIN as _ORIGIN
from fingerflow.results.tables.grid_maps import described, interpolate_maps, map_table
from fingerflow.results.tables.matlab import save_matlab

ROWS = {"frame": frame_table, "point": point_table, "track": track_table}
_COMPLETE = {".mat": save_matlab, ".nwb": save_nwb, ".zarr": save_zarr}
_BEGINNINGS = (b"frame,", b"track_id,")


def export_table(
    result: xr.Dataset, path: Path, rows: str = "frame", variables: Sequence[str] | None = None, overwrite: bool = False
) -> None:
    """Write a table of a result as .csv, or the complete result as .mat, .nwb or .zarr.

    Args:
        result: of `process`, or of a stream.
        path: ending in .csv, .mat, .nwb (extra `nwb`) or .zarr (a folder, extra `zarr`). A .csv has shown units
            (`fingerflow outputs`), the others those of the data set.
        rows: kind of rows of a .csv: "frame"; "point", one per point and frame; "track", the tracks of napari
            (ID, t, y, x) in frames and px, where the point is tracked.
        variables: columns of the table; None for all variables that have a value for each row, or none of "track".
        overwrite: replace any file, not only a table or map.

    Raises:
        FingerflowError: for another suffix, a variable that the result does not have or that has other rows, or
            without ``overwrite`` where the path is an existing file that is no table or map.
    """
    # Not even `overwrite` replaces a folder of another kind.
    if path.suffix == ".zarr" and path.exists() and not is_zarr_result(path):
        raise FingerflowError(f"{path} exists and is no result; give another name, or remove it")
    keep_others(path, is_table, overwrite)
    if rows not in ROWS:
        raise FingerflowError(f"rows of {rows!r} are not known; choose {', '.join(ROWS)}")
    if path.suffix == ".csv":
        write_csv(path, ROWS[rows](result, variables))
        return
    if path.suffix not in _COMPLETE:
        raise FingerflowError(f"{path}: a table is written as .csv, {', '.join(_COMPLETE)}, not {_suffix(path)}")
    if rows != "frame" or variables:
        raise FingerflowError(
            f"{path}: a {path.suffix} file holds everything; leave rows and variables out, or take .csv"
        )
    _COMPLETE[path.suffix](result, path)


def export_map(result: xr.Dataset, path: Path, variable: str, step_mm: float = 0.1, overwrite: bool = False) -> None:
    """Write maps of a variable on a regular grid on the glass, one for each frame, to a file.

    Args:
        result: of `process`.
        path: .tif, a float32 stack for ImageJ with mm and s in its tags, channels where the variable has components,
            NaN where it is not known; or .csv, one row per known grid position with frame, time, x and y.
        variable: with a value for each point, or each triangle, in each frame.
        step_mm: spacing of the grid.
        overwrite: replace any file, not only a table or map.

    Raises:
        FingerflowError: for another suffix or step, a variable that cannot be mapped, or without ``overwrite`` where
            the path is an existing file that is no table or map.
    """
    keep_others(path, is_table, overwrite)
    if path.suffix in (".tif", ".tiff"):
        maps = interpolate_maps(result, variable, step_mm)
        write_atomically(path, lambda part: _write_tiff(part, maps))
    elif path.suffix == ".csv":
        write_csv(path, map_table(interpolate_maps(result, variable, step_mm)))
    else:
        raise FingerflowError(f"{path}: a map is written as .tif or .csv, not {_suffix(path)}")


def is_table(path: Path) -> bool:
    """Return whether a file is a table or map written by this module, judged by first bytes, variables or tags."""
    try:
        if path.suffix == ".mat":
            return {"time", "frame", "units"} <= {name for name, _, _ in scipy.io.whosmat(str(path))}
        if path.suffix in (".tif", ".tiff"):
            with tifffile.TiffFile(path) as file:
                return _ORIGIN in str((file.imagej_metadata or {}).get("Info", ""))
        if path.suffix == ".nwb":
            return is_nwb_result(path)
        with path.open("rb") as table:
            return table.read(max(map(len, _BEGINNINGS))).startswith(_BEGINNINGS)
    except Exception:  # a file of another kind may raise any exception
        return False


def _write_tiff(part: Path, maps: xr.DataArray) -> None:
    names = {"Info": described(maps)}
    several = maps["component"].values.tolist() != [maps.name]
    if several:
        names["Labels"] = maps["component"].values.tolist() * len(maps)
    steps = np.diff(maps["time"])
    interval = {"finterval": float(np.median(steps)), "tunit": "s"} if len(steps) else {}
    with part.open("wb") as file:
        tifffile.imwrite(
            file,
            maps.values if several else maps.values[:, 0],
            imagej=True,
            resolution=(1 / maps.attrs["step_mm"], 1 / maps.attrs["step_mm"]),
            metadata={"axes": "TCYX" if several else "TYX", "unit": "mm", **interval, **names},
        )


def _suffix(path: Path) -> str:
    return path.suffix or "without a suffix"
