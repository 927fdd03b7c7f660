"""Wrong scene files and the error message of each, for all readers of scenes.

A case changes one part of a valid scene, in a folder that `write_folder` makes. ``said`` is a part of the one-line
message, ``start`` is the beginning of the line that the message blames, in the changed file.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from fingerflow.calibration import Calibration, Disc, Transform
from fingerflow.schema.views import View

RIGHT = """\
[recording]
frames = "frames.npy"
frame_rate = 300.0
first_frame = 2
last_frame = 20

[views.contact]
rows = [0, 512]
columns = [640, 1280]

[views.topography]
rows = [0, 500]
columns = [0, 640]

[background]
frames = "empty.npy"
dark = "dark.npy"

[forces]
file = "forces.csv"
normal = "normal_force"
tangential = "tangential_force"
trigger = "trigger"
trigger_level = 2.5
sample_rate = 1000.0

[calibration]
mm_per_px = 0.0325
topography_to_contact = [[1.01, -0.01, 3.4], [0.01, 1.01, -6.2]]

[contact]
median_px = 3
threshold = "reference_frame"
gross_radius_px = 8

[tracking]
points = 700
window_px = 25
min_distance_px = 6.0
direction = "forward"
template = "keyframe"
forward_backward_limit_px = 1.0
search_px = 8
gain_offset = true

[fields]
gauge_length_mm = 1.6
strain = "green_lagrange"
young_modulus_mpa = 1.0
poisson_ratio = 0.4
depth_mm = 2.0
rate_window_s = 0.05

[stream]
output = "results"
region = {rows = [100, 400], columns = [100, 540]}
update_share = 0.8
update_frames = 300
"""
CALIBRATION = RIGHT[RIGHT.index("mm_per_px") : RIGHT.index("\n\n[contact]")]
CORNERS = "[[0, 0], [9, 9], [5, 0]]"
MATRIX = "[[1.01, -0.01, 3.4], [0.01, 1.01, -6.2]]"
_VIEWS = {"topography": View((0, 500), (0, 640)), "contact": View((0, 512), (640, 1280))}


class WrongScene(NamedTuple):
    old: str
    new: str
    start: str
    said: str


def write_folder(folder: Path) -> Path:
    """Write the files that RIGHT names, and calibrations; return the path of a scene file that does not exist yet."""
    for name in ("frames.npy", "empty.npy", "dark.npy", "forces.csv"):
        (folder / name).write_bytes(b"")
    hole = Disc((100.0, 90.0), (80.0, 79.0), 0.3, 0.1, 0.5, 1.0, 0.4, 30.0)
    transform = Transform(np.array([[1.01, -0.01, 3.4], [0.01, 1.01, -6.2]]), np.zeros((3, 2)))

    def rig(views: dict[str, View], both: Transform | None = transform) -> str:
        return Calibration(0.0325, 2.75, hole, views, affine=both, similarity=both).to_toml()

    texts = {
        "rig": rig(_VIEWS),
        "other_rig": rig(_VIEWS | {"contact": View((0, 512), (650, 1280))}),
        "other_topography": rig(_VIEWS | {"topography": View((1, 501), (0, 640))}),
        "ring_alone": rig({"contact": _VIEWS["contact"]}, None),
        "coarse": rig(_VIEWS).replace("mm_per_px = 0.0325", "mm_per_px = 3.25"),
        "negative": rig(_VIEWS).replace("mm_per_px = 0.0325", "mm_per_px = -0.0325"),
        "flat": rig(_VIEWS).replace("0.01, 1.01, -6.2", "1.01, -0.01, -6.2"),
        "no_views": "mm_per_px = 0.0325\n",
        "broken": "mm_per_px 0.0325\n",
        "of_words": rig(_VIEWS).replace("mm_per_px = 0.0325", 'mm_per_px = "small"'),
    }
    for name, text in texts.items():
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    return folder / "scene.toml"


def _forces(line: str, said: str) -> tuple[str, str, str, str]:
    """Return a case with an additional line in [forces]."""
    return 'normal = "normal_force"', f'normal = "normal_force"\n{line}', line.partition(" ")[0], f"forces.{said}"


def _number(key: str, value: str, said: str, wrong: str) -> tuple[str, str, str, str]:
    return f"{key} = {value}", f"{key} = {wrong}", f"{key} = {wrong}", said


def _region(region: str, said: str) -> tuple[str, str, str, str]:
    return "columns = [640, 1280]\n", f"columns = [640, 1280]\nregion = {{{region}}}\n", "region", said


def _calibrated(name: str, said: str, start: str = "") -> tuple[str, str, str, str]:
    file = f'file = "{name}.toml"'
    return CALIBRATION, file, start or file, said


_ROWS = (
    # Missing and unknown keys.
    ("[recording]", "[recordings]", "[recordings]", "recordings is not a key; did you mean 'recording'?"),
    ("median_px", "median_pix", "median_pix", "contact.median_pix is not a key; did you mean 'median_px'?"),
    ("[tracking]", "[tracking]\nturbo = 9", "turbo", "tracking.turbo is not a key; known here: direction,"),
    ("[recording]", 'path = "x"\n[recording]', "path", "path is not a key; known here: background, calib"),
    ("[views.contact]", "[views.contct]", "[views.contct]", "views.contct is not a key; did you mean 'con"),
    ("rows = [0, 512]\n", "", "[views.contact]", "views.contact.rows is missing; add it"),
    (f"[calibration]\n{CALIBRATION}", "", "[recording]", "calibration is missing; add it"),
    (", columns = [100, 540]}", "}", "region", "stream.region.columns is missing; add it"),
    ("update_frames = 300", "rekey_frames = 300", "rekey_frames", "did you mean 'update_frames'?"),
    # Kinds and types.
    ("[recording]", 'kind = "poke"\n[recording]', "kind", "kind is 'poke': it should be 'press', 'slip'"),
    ("[recording]", 'profile = "x"\n[recording]', "profile", "profile is 'x': it should be 'willemet_2021'"),
    ("[fields]", "[[fields]]", "[[fields]]", "fields is [{'gauge_length_mm': 1.6, "),
    ("[stream]", "[slip]\nstuck_mm = {a = 1}\n[stream]", "stuck_mm", "slip.stuck_mm is a table: it should be"),
    ("{rows = [100, 400], columns = [100, 540]}", "7", "region", "stream.region is 7: it should be a table"),
    ('frames = "frames.npy"', "frames = 3", "frames = 3", "recording.frames is 3: that is no path of a file"),
    ('normal = "normal_force"', "normal = 0", "normal", "forces.normal is 0: it should be the name of"),
    _number("points", "700", "tracking.points is '700': it should be a whole number", '"700"'),
    _number("points", "700", "tracking.points is True: it should be a whole number", "true"),
    _number("points", "700", "tracking.points is 700.0: it should be a whole number", "700.0"),
    _number("gauge_length_mm", "1.6", "fields.gauge_length_mm is 1e-300: it should be at least 0.001", "1e-300"),
    _number("depth_mm", "2.0", "fields.depth_mm is inf: it should be a finite number", "inf"),
    _number("gain_offset", "true", "tracking.gain_offset is 0: it should be true or false", "0"),
    # Ranges and enumerations.
    _number("points", "700", "tracking.points is 2: it should be at least 3", "2"),
    _number("window_px", "25", "tracking.window_px is 24: 24 is even; the middle pixel needs an odd side", "24"),
    _number("mm_per_px", "0.0325", "calibration.mm_per_px is 32.5: it should be at most 1", "32.5"),
    _number("poisson_ratio", "0.4", "fields.poisson_ratio is 0.5: it should be below 0.5", "0.5"),
    _number("poisson_ratio", "0.4", "fields.poisson_ratio is -1.0: it should be above -1", "-1.0"),
    _number("frame_rate", "300.0", "recording.frame_rate is 3.001e-318: it should be above 1e-06", "300.1e-320"),
    _number("direction", '"forward"', "tracking.direction is 'up': it should be 'forward' or 'backward'", '"up"'),
    _number("strain", '"green_lagrange"', "'as_printed' or 'infinitesimal'", '"hencky"'),
    _number("threshold", '"reference_frame"', "'per_frame', or it should be below 1", "35"),
    _number("threshold", '"reference_frame"', "contact.threshold is 'auto': it should be 'refer", '"auto"'),
    ("[fields]", '[fields]\nreference = "contact"', "ref", "fields.reference is 'contact': it should be 'onset'"),
    ("[fields]", "[fields]\nreference = 0.25", "reference", 'in quotes and with its unit, "0.25 s"'),
    # Pixels and transforms.
    _number("rows", "[0, 512]", "views.contact.rows is 512: two whole numbers [first, end) with", "512"),
    _number("rows", "[0, 512]", "views.contact.rows is [0, True]: of item 2 it should be a whole", "[0, true]"),
    _number("columns", "[0, 640]", "views.topography.columns is [3, 3]: two whole numbers [first, end)", "[3, 3]"),
    _number("columns", "[640, 1280]", "with 0 <= first < end are needed", "[-1, 1280]"),
    _number("topography_to_contact", MATRIX, "of item 1 three numbers are needed; a transform", "[[1, 0], [0, 1]]"),
    _number("topography_to_contact", MATRIX, "of item 1 of item 3 it should be a number", "[[1, 0, 'x'], [0, 1, 0]]"),
    _number("topography_to_contact", MATRIX, "that does not map the whole view onto a line", "[[1, 2, 3], [2, 4, 0]]"),
    _number("topography_to_contact", MATRIX, "of item 3 it should be at most 1e+06", "[[1, 0, 1e9], [0, 1, 0]]"),
    ("mm_per_px", "intrinsics = [9.0, 9.0]\nmm_per_px", "intr", "it should be a list of 4 numbers, [fx, fy, cx, cy]"),
    ("mm_per_px", "intrinsics = [9, 0, 1, 1]\nmm_per_px", "intr", "of item 2 it should be above 0; it should be a "),
    ("mm_per_px", "distortion = [1, 0, 0, 0]\nmm_per_px", "dist", "a list of 5 numbers, [k1, k2, p1, p2, k3]"),
    ("mm_per_px", "distortion = [1, 0, 0, 0, 0]\nmm_per_px", "dist", "it needs intrinsics = [fx, fy, cx, cy], px"),
    # Keys that contradict each other.
    _number("last_frame", "20", "recording.last_frame is 1: that is before first_frame, 2; both are included", "1"),
    ("trigger_level = 2.5\n", "", "trigger = ", "forces.trigger is 'trigger': trigger and trigger_level belo"),
    ('trigger = "trigger"\n', "", "trigger_level", "forces.trigger_level is 2.5: trigger and trigger_level"),
    ("rows = [100, 400]", "rows = [100, 501]", "region", "it ends beyond the topography view of 500 x 640 px"),
    (f"topography_to_contact = {MATRIX}", "", "mm_per_px", "calibration.mm_per_px is 0.0325: the scene has"),
    ("[calibration]", '[calibration]\nfile = "rig.toml"', 'file = "rig', "a file and mm_per_px, topography_to_cont"),
    # Force sensors.
    ('normal = "normal_force"', 'normal = ["a", "b"]', "normal", "forces.normal is ['a', 'b']: it should be"),
    ('"tangential_force"', '["a", "b", "c"]', "tang", "or a list of up to 2 of them"),
    _forces('units = "lbf"', "units is 'lbf': it should be 'N', 'mN', 'g', 'kgf' or 'V'"),
    _forces("sign = 2", "sign is 2: it should be 1 or -1"),
    _forces('sign = "-1, 1"', "sign is '-1, 1': it should be 1, -1 or a list with one for each channel, such as"),
    _forces("gain = [1.0, 2.0, 3.0]", "gain is [1.0, 2.0, 3.0]: it has 3 numbers for 2 forces"),
    _forces("gain = []", "gain is []: it should be a number or a list with one for each channel, such as [2.5, 4]"),
    _forces("offset = inf", "offset is inf: it should be a finite number"),
    _forces("tare = [0.2, 0.1]", "tare is [0.2, 0.1]: two times in s from the trigger are needed, the earlier"),
    _forces("tare = [0.0, 0.1]\noffset = 1.0", "tare is [0.0, 0.1]: it and offset exclude each other"),
    # Regions.
    _region("polygon = [[0, 0], [9, 9]]", "polygon is [[0, 0], [9, 9]]: three or more corners [x, y] in px of the"),
    _region("polygon = [[0, 0], [9, 9], [5, 5]]", "not all on a line, are needed"),
    _region("polygon = [[0, 0], [9, 9], [5e9, 0]]", "of item 1 it should be at most 1e+06"),
    _region("ellipse = {center = [9, 9]}", "ellipse.semi_axes is missing; add it"),
    _region("ellipse = {center = [9, 9], semi_axes = [1e-200, 1]}", "of item 1 it should be at least 0.001"),
    _region("", "one of 'polygon', 'ellipse' or 'mask' is needed, and there are none"),
    _region(f"polygon = {CORNERS}, ellipse = {{center = [9, 9], semi_axes = [2, 1]}}", "there are polygon and ellipse"),
    _region("circle = 3", "is not a key; known here: ellipse, mask, polygon"),
    # Calibrations.
    _calibrated("nothing", "calibration.file is 'nothing.toml': "),
    _calibrated("other_rig", "made with the contact view rows [0, 512], columns [650, 1280], and the scene has"),
    _calibrated("other_topography", "made with the topography view rows [1, 501], columns [0, 640], and the sce"),
    _calibrated("ring_alone", "the scene has a topography view, and nothing says where its pixels are in the con"),
    _calibrated("coarse", "calibration.mm_per_px is 3.25: it should be at", "[calibration]"),
    _calibrated("negative", "mm_per_px is -0.0325: it should be above 0; write it a"),
    _calibrated("flat", "that does not map the whole view onto a line is needed; write it again"),
    _calibrated("no_views", "calibration has no entry 'views'; write it again"),
    _calibrated("broken", "broken.toml: this calibration cannot be read: "),
    _calibrated("of_words", "an entry of this calibration is wrong: mm_per_px is 'small'"),
)
WRONG = tuple(WrongScene(*row) for row in _ROWS)
