"""Session of the page: draft of a scene, result, open files and running commands, with a lock for parallel requests."""

import contextlib
import json
import os
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tomlkit
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat
from tomlkit.exceptions import TOMLKitError

from fingerflow.errors import FingerflowError
from fingerflow.kernels.arrays import nanmedian
from fingerflow.player.binary_answer import packed
from fingerflow.player.page_token import new_token
from fingerflow.recordings import force_columns, open_recording
from fingerflow.results.result import is_result, open_result
from fingerflow.schema.scene import Scene, load_scene, scene_of_settings
from fingerflow.schema.scene_kinds import KINDS
from fingerflow.schema.views import View
from fingerflow.view.command import Command
from fingerflow.view.draft import Draft, files_beside, list_names
from fingerflow.view.key_forms import field_name, forms, reword
from fingerflow.view.open_path import RESULT
from fingerflow.view.pictures import Pictures
from fingerflow.view.results import Results

if TYPE_CHECKING:  # torch takes seconds to load, and the first picture does not need it
    from fingerflow.view.preview import Previewer

Facts = dict[str, Any]
Point = Annotated[int, Field(lt=2**31)]  # index of a point in a request of the page


class Session:
    """State of the page on the server (edited scene, result, open files, running commands), shared by all browser
    windows; its methods answer the requests of the page.

    Attributes:
        lock: to be held during all calls but those that another one, which takes long, must not delay.
    """

    def __init__(self, draft: Draft | None, result: Path | None) -> None:
        self.lock = threading.RLock()
        self._draft = draft
        self._pictures: dict[tuple[Path, float | None], Pictures] = {}
        self._preview: tuple[str, Previewer] | None = None
        self._result_path = result
        self._result: Results | None = None
        self._scene_of_result: Scene | None = None
        self._result_preview: Previewer | None = None
        self._columns: tuple[tuple[Path, int] | None, list[str]] = (None, [])
        self._runs: dict[str, Command] = {}  # last run of `process` and of `report`
        self.report_name = f"report-{new_token()}.html"  # a new window opens it by its name, without the page's header

    def open(self) -> None:
        """Load the draft of the scene and the result before the first request of the page; errors are reported by later
        requests.
        """
        if self._result_path is not None:
            with contextlib.suppress(FingerflowError):
                self.result()
        with contextlib.suppress(FingerflowError):
            self.setup()

    def ready(self) -> Facts:
        """Import the modules for previews in advance, so that the first preview starts faster."""
        import fingerflow.view.preview  # noqa: F401

        return {"ready": True}

    def close(self) -> None:
        """Stop running commands and close files."""
        for run in self._runs.values():
            run.end()
        with self.lock:
            self._close_result()
            for pictures in self._pictures.values():
                pictures.recording.close()
            self._pictures.clear()

    # Setting up.

    def setup(self) -> Facts:
        """Return the draft of the scene file for the page: values, validation problems and recording properties."""
        self.progress("process")  # a run may have ended while no page was open
        draft = self._draft
        if draft is None:
            return {"draft": None, "result": self._result_path is not None}
        facts: Facts = {
            "draft": str(draft.path),
            "values": draft.values(),
            "kind": draft.scene_kind(),
            "problems": draft.problems(),
            "stored": draft.is_stored,
            "text": draft.text,
            "forms": forms(),
            "kinds": list(KINDS),
            "files": files_beside(draft.path),
            "channels": self._channels(),
            "calibration_picture": _calibration_picture(draft) is not None,
            "result": self._result_path is not None,
        }
        try:
            pictures = self._pictures_of_draft()
        except FingerflowError as error:
            facts["recording"], facts["recording_error"] = None, reword(str(error))
        else:
            facts["recording"] = _recording_facts(pictures)
            if pictures.recording.times is None:
                problem, key = "is needed: the recording does not state it (Hz)", "recording.frame_rate"
                facts["problems"].append({"key": key, "field": field_name(key), "said": problem})
        return facts

    def folder(self, at: str = "") -> Facts:
        """Return the folders and files in a folder, which is given relative to that of the scene file."""
        start = self._drafted().path.parent
        folder = (start / at).resolve()
        folders, files = list_names(folder)
        relative = os.path.relpath(folder, start).replace(os.sep, "/")
        return {"folder": str(folder), "at": "" if relative == "." else relative, "folders": folders, "files": files}

    def frame(self, frame: int, contact: bool = False) -> bytes:
        """Return the image of a frame (index in the file) and, if requested, the contact predicted in it, as packed
        bytes.
        """
        pictures = self._pictures_of_draft()
        if not 0 <= frame < len(pictures.recording):
            raise FingerflowError(
                f"frame {frame} is not among the {len(pictures.recording)} of {pictures.recording.path}"
            )
        facts = {"frame": frame, "every": pictures.every, "shape": pictures.recording.frame_shape}
        arrays = {"picture": pictures.picture(frame)}
        if contact:
            try:
                facts["numbers"], maps = self._contact_facts(self._previewer(), frame)
            except FingerflowError as error:
                facts["why_no_contact"] = reword(str(error))
            else:
                arrays |= maps
        return packed(facts, arrays)

    def points(self) -> bytes:
        """Return the positions (N, 2) px of the points that `process` would track, with their frame and warnings, as
        packed bytes.
        """
        points, frame, warnings = self._previewer().chosen()
        facts = {"frame": frame + self._previewer().scene.recording.first_frame, "warnings": [*map(reword, warnings)]}
        return packed(facts, {"points": points.astype(np.float32)})

    def forces(self) -> bytes:
        """Return the forces of the edited scene at the times of its frames, with its calibration and warnings, as
        packed bytes.
        """
        previewer = self._previewer()
        scene = previewer.scene
        facts = {
            "first_frame": scene.recording.first_frame,
            "warnings": [*map(reword, previewer.warnings)],
            "mm_per_px": scene.calibration.mm_per_px,
            "topography_to_contact": scene.calibration.topography_to_contact,
        }
        return packed(facts, {"time": previewer.times, **previewer.forces()})

    def calibration_picture(self) -> bytes | None:
        """Return the overlay image that `fingerflow calibrate` wrote beside the draft's calibration file, or None."""
        path = None if self._draft is None else _calibration_picture(self._draft)
        return None if path is None else path.read_bytes()

    def calibrate(
        self,
        ring: str | None = None,
        target: str | None = None,
        background: str | None = None,
        chessboard: str | None = None,
        corners: Sequence[int] = (),
        hole_radius_mm: FiniteFloat | None = None,
    ) -> Facts:
        """Calibrate from image files with the views of the draft, as `fingerflow calibrate` does, and return `setup()`.

        The files are in the scene's folder; the calibration file written there becomes that of the draft.

        Args:
            ring, target, background, chessboard: names of files, empty for none.
            corners: numbers of inner corners in a row and in a column of the chessboard.
            hole_radius_mm: of the ring.
        """
        from fingerflow.calibration import FILE, calibrate_files

        draft = self._drafted()
        folder, stated = draft.path.parent, draft.table("views")
        if not ring:
            raise FingerflowError("name the picture of the ring: it gives the scale")
        named = {"target": target, "background": background, "chessboard": chessboard}
        files: dict[str, Any] = {name: folder / file for name, file in named.items() if file}
        ranges = {"contact": stated.get("contact", stated.get("camera"))}
        ranges["topography"] = "target" in files and stated.get("topography")
        views = {name: View(pixels["rows"], pixels["columns"]) for name, pixels in ranges.items() if pixels}
        if corners:
            files["corners"] = tuple(corners)
        if hole_radius_mm:
            files["hole_radius_mm"] = hole_radius_mm
        calibration = calibrate_files(folder / ring, views=views, output=folder / FILE, **files)
        for key in ("mm_per_px", "topography_to_contact", "intrinsics", "distortion"):
            draft.set(("calibration", key), None)
        draft.set(("calibration", "file"), FILE)
        warnings = [*map(reword, calibration.warnings)]
        return {**self.setup(), "calibrated": {"mm_per_px": calibration.mm_per_px, "warnings": warnings}}

    def edit(self, set: Sequence[tuple[str, Any]]) -> Facts:
        """Set keys of the draft, given as pairs (dotted key, value); a value {"toml": text} is parsed as TOML.

        Raises:
            FingerflowError: keys that cannot be set, after all others were set.
        """
        draft, refused = self._drafted(), []
        for key, value in set:
            try:
                if key == "kind":
                    draft.set_kind(str(value), self._pictures_of_draft().recording.frame_shape)
                else:
                    draft.set(tuple(key.split(".")), _shown_value(value))
            except FingerflowError as error:
                refused.append(str(error))
        if refused:
            raise FingerflowError("; ".join(refused))
        return self.setup()

    def write(self, to: str | None = None, replace: bool = False) -> Facts:
        """Write the draft as the scene file, or to another file `to` in its folder; raise NeedsLeaveError before
        overwriting content that the page has not read, unless `replace`.
        """
        self._drafted().write(self._drafted().path.parent / to if to else None, replace)
        return self.setup()

    # Processing.

    def process(self, all: bool = False) -> Facts:
        """Start `fingerflow process` on the saved scene; the command writes `result.h5` into the folder of the scene.

        With `all`, also request the variables computed only on request: principal strains, shear.
        """
        draft = self._drafted()
        if not draft.is_stored:
            raise FingerflowError("the scene file differs from what is on this page; write it first")
        self._refuse_two()
        scene, to = load_scene(draft.path), draft.path.parent / RESULT
        arguments: list[str | Path] = ["process", draft.path, "--output", to]
        self._close_result()  # some systems cannot replace an open file
        if is_result(to):
            with open_result(to) as earlier:
                recorded = json.loads(earlier.attrs["settings"])["recording"]
            if recorded == json.loads(scene.as_json())["recording"]:  # reuses results that are still valid
                arguments += ["--from", to]
        if all:
            from fingerflow.view.preview import all_of_default_stages

            for name in all_of_default_stages(scene):
                arguments += ["--variable", name]
        self._runs["process"] = Command(arguments, to)
        return self.progress("process")

    def report(self) -> Facts:
        """Start `fingerflow report`, which writes `report.html` and `overlay.mp4` into the scene's folder."""
        self._refuse_two()
        result, scene = self._opened_result().path, self._result_scene().path
        self._runs["report"] = Command(["report", scene, "--result", result], scene.parent / "report.html")
        return self.progress("report")

    def report_page(self) -> bytes | None:
        """Return the HTML report that was written in this session, or None."""
        run = self._runs.get("report")
        return run.to.read_bytes() if run is not None and run.state()["ended_well"] else None

    def end(self, of: str) -> Facts:
        """Stop a running `process` or `report` command, and return its progress."""
        if of in self._runs:
            self._runs[of].end()
        return self.progress(of)

    def progress(self, of: str) -> Facts:
        """Return the progress of the `process` or `report` command."""
        if of not in self._runs:
            return {"running": False, "none": True}
        state = self._runs[of].state()
        if of == "process" and state["ended_well"]:
            self._result_path = self._runs[of].to
        return {**state, "said": [*map(reword, state["said"])], "page": self.report_name}

    def _refuse_two(self) -> None:
        if any(run.state()["running"] for run in self._runs.values()):
            raise FingerflowError("a run is under way; wait for it, or end it")

    # Looking at results.

    def result(self) -> Facts:
        """Return metadata of the result, the views of its scene and properties of its recording."""
        facts = self._opened_result().facts()
        try:
            scene = self._result_scene()
            facts["views"] = {name: {"rows": view.rows, "columns": view.columns} for name, view in scene.views.items()}
            facts["kind"], facts["scene"] = scene.kind, str(scene.path)
            facts["recording"] = _recording_facts(self._shown_pictures(scene.recording.frames, None))
        except FingerflowError as error:
            facts["recording"], facts["recording_error"] = None, str(error)
        return facts

    def result_frame(self, frame: int, shown: str | None = None, contact: bool = False) -> bytes:
        """Return the values of a frame of the result as packed bytes, with its image if the recording can be read."""
        numbers, arrays = self._opened_result().frame(frame, shown)
        facts = {"frame": frame, "numbers": numbers, "every": 1, "shape": None}
        try:
            scene = self._result_scene()
            pictures = self._shown_pictures(scene.recording.frames, None)
            facts["every"], facts["shape"] = pictures.every, pictures.recording.frame_shape
            number = frame + scene.recording.first_frame
            arrays["picture"] = pictures.picture(number)
            if contact:
                self._result_preview = self._result_preview or _make_previewer(scene)
                arrays |= self._contact_facts(self._result_preview, number)[1]
        except FingerflowError as error:
            facts["why_no_picture"] = str(error)
        return packed(facts, arrays)

    def result_range(self, key: str) -> Facts:
        """Return the limits of the colour scale for a key (variable, or variable:component)."""
        return {"key": key, "range": self._opened_result().value_range(key)}

    def result_triangles(self) -> bytes:
        """Return the corners of the result's triangles as packed bytes."""
        return packed({}, {"triangles": self._opened_result().triangles()})

    def result_courses(self, keys: Sequence[str]) -> bytes:
        """Return time series of the result for the variables or components that keys name, as packed bytes."""
        result = self._opened_result()
        return packed({"keys": list(keys)}, {key: result.course(key) for key in keys})

    def result_history(self, key: str, points: list[Point]) -> bytes:
        """Return the time series of a variable at one point with its status, or the median over several points, with
        the number of points at which it is known, as packed bytes.
        """
        result = self._opened_result()
        values = result.point_courses(key, points)
        arrays = {"values": nanmedian(values), "known": np.isfinite(values).sum(axis=1).astype(np.int32)}
        if len(points) == 1 and "status" in result.data:
            arrays["status"] = result.point_courses("status", points)[:, 0].astype(np.uint8)
        return packed({"key": key, "points": points}, arrays)

    def result_table(
        self, of: str, frame: int = 0, shown: str | None = None, keys: Sequence[str] = (), points: Sequence[Point] = ()
    ) -> str:
        """Return CSV text of the time series, or of the frame, that the page displays; with the time series `keys` the
        median of `shown` over selected points.
        """
        if of == "frame":
            return self._opened_result().table_of_frame(frame, shown)
        return self._opened_result().table_of_courses(keys, points, shown)

    # What is opened.

    def _drafted(self) -> Draft:
        if self._draft is None:
            raise FingerflowError("there is no scene to set up: a result alone was opened; name its scene instead")
        return self._draft

    def _channels(self) -> list[str]:
        """Return the column names of the force file that the edited scene names; an empty list if the file cannot be
        read.
        """
        file = self._drafted().table("forces").get("file")
        path = self._drafted().path.parent / file if isinstance(file, str) and file else None
        try:
            state = None if path is None else (path, path.stat().st_mtime_ns)
            if state != self._columns[0]:
                self._columns = (state, [] if path is None else force_columns(path))
        except (FingerflowError, OSError, ValueError):  # ValueError: a name that no file can have
            self._columns = (None, [])
        return self._columns[1]

    def _pictures_of_draft(self) -> Pictures:
        draft = self._drafted()
        recording = draft.table("recording")
        frames, rate = recording.get("frames"), recording.get("frame_rate")
        if not isinstance(frames, str):
            raise FingerflowError("choose a recording: no file is named in [recording] frames")
        return self._shown_pictures(draft.path.parent / frames, rate if isinstance(rate, float | int) else None)

    def _shown_pictures(self, path: Path, rate: float | None) -> Pictures:
        if (path, rate) not in self._pictures:
            self._pictures[path, rate] = Pictures(open_recording(path, frame_rate=rate))
        return self._pictures[path, rate]

    def _previewer(self) -> "Previewer":
        text = self._drafted().text
        if self._preview is None or self._preview[0] != text:
            before = None if self._preview is None else self._preview[1]
            self._preview = (text, _make_previewer(self._drafted().scene(), before))
        return self._preview[1]

    def _contact_facts(self, previewer: "Previewer", number: int) -> tuple[Facts, dict[str, NDArray[Any]]]:
        """Return the predicted contact in a frame (index in the file): numbers by name and arrays by name, the latter
        empty for a frame that the scene does not select.
        """
        index = number - previewer.scene.recording.first_frame
        if not 0 <= index < len(previewer.times):
            return {"counts": False}, {}
        mask, numbers = previewer.contact(index)
        return {"counts": True, "time": float(previewer.times[index]), **numbers}, {"mask": mask.astype(np.uint8)}

    def _opened_result(self) -> Results:
        if self._result is None:
            if self._result_path is None or not is_result(self._result_path):
                raise FingerflowError("there is no result yet; process the scene first")
            self._result = Results(self._result_path)
        return self._result

    def _result_scene(self) -> Scene:
        result = self._opened_result()
        if self._scene_of_result is None:
            self._scene_of_result = scene_of_settings(result.data.attrs["settings"])
        return self._scene_of_result

    def _close_result(self) -> None:
        if self._result is not None:
            self._result.close()
        self._result = self._result_preview = self._scene_of_result = None


def _recording_facts(pictures: Pictures) -> Facts:
    recording = pictures.recording
    return {
        "path": str(recording.path),
        "frames": len(recording),
        "shape": recording.frame_shape,
        "bit_depth": recording.bit_depth,
        "frame_rate": recording.frame_rate,
        "warnings": recording.warnings,
    }


def _make_previewer(scene: Scene, before: "Previewer | None" = None) -> "Previewer":
    from fingerflow.view.preview import Previewer

    return Previewer(scene, before)


def _calibration_picture(draft: Draft) -> Path | None:
    file = draft.table("calibration").get("file")
    picture = (draft.path.parent / file).with_suffix(".png") if isinstance(file, str) and file else None
    return picture if picture is not None and picture.is_file() else None


def _shown_value(value: Any) -> Any:
    """Return a value sent by the page as a Python value; TOML text is parsed, or kept as text if invalid."""
    if not isinstance(value, dict) or "toml" not in value:
        return value
    try:
        return tomlkit.parse(f"value = {value['toml']}")["value"]
    except (TOMLKitError, ValueError, RecursionError):
        return str(value["toml"])
