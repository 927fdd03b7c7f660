"""Columns of the table of trials: name, unit and definition of each, as written to `variables.csv` beside the table.

A metric is named as in `fingerflow.report.trial_metrics`. Without a suffix it is the value shown in figures; with
`_at_1n`, `_at_onset` and so on it is the value at that moment. `_std` is its standard deviation.
"""

from collections.abc import Iterator

from fingerflow.schema.variables import Variable

#: Moments of a trial and their definitions.
FORCES_N = (1.0, 2.0, 3.0)
AT_ONSET, AT_MAX = "at_onset", "at_max"
MOMENTS = {
    **{f"at_{force:g}n": f"when the normal force first reaches {force:g} N" for force in FORCES_N},
    AT_ONSET: "in the first frame with contact",
    AT_MAX: "at the largest normal force, without forces at the largest gross contact area",
}
_TRIAL = ("trial",)
_LARGEST = "the largest of the trial"

#: Quantities at every moment: name, unit, definition, whether it has a standard deviation, and whether the column
#: without a suffix is the largest value of the trial (True) or the value at the maximum (False).
AT_MOMENTS: tuple[tuple[str, str, str, bool, bool], ...] = (
    ("real_contact_area", "mm2", "real contact area", False, False),
    ("gross_contact_area", "mm2", "gross contact area", False, False),
    ("divergence", "1", "median divergence over the gross contact", True, False),
    ("curl", "rad", "median curl over the gross contact", True, False),
    ("strain", "1", "median strain along the major axis that the gross contact has at its maximum", True, False),
    ("strain_across", "1", "median strain across that axis", True, False),
    ("strain_energy", "mJ", "strain energy of the skin in contact", True, False),
    ("divergence_rate", "1/s", "rate of the median divergence", False, True),
    ("strain_rate", "1/s", "rate of the strain along the major axis", False, True),
    ("strain_energy_rate", "mJ/s", "rate of the strain energy", False, True),
    ("global_displacement", "mm", "length of the median displacement since onset", False, True),
    ("force_angle", "rad", "angle of the force from the normal, atan |T/N|", False, True),
    ("coverage", "1", "share of the points in contact that are tracked", False, False),
)
_OF_TRIAL = (
    ("max_force", "N", "largest normal force"),
    ("time_to_max_force", "s", "from the first frame with contact to the largest normal force"),
    ("duration", "s", "from the first frame with contact to the last"),
    ("force_rate", "N/s", "largest rate of the normal force from the first contact to the largest force"),
    ("max_displacement", "mm", "largest displacement since onset: the 0.99 quantile over points in contact, so that "
     "one lost point does not decide"),
    ("max_speed", "mm/s", "largest speed, up to the largest force, of the point that has that displacement"),
    ("friction", "1", "median T/N where no skin sticks any more; nothing where the finger did not slide"),
    ("longest_axis_ratio", "1", "major over minor axis of the gross contact at its maximum: near 1 the directions "
     "along and across are chance"),
)  # fmt: skip
#: Added when the table is written: each area over the median of its participant.
NORMALISED = ("real_contact_area", "gross_contact_area")


def _all() -> Iterator[Variable]:
    for name, unit, said in _OF_TRIAL:
        yield Variable(name, _TRIAL, unit, said)
    for name, unit, said, has_std, largest in AT_MOMENTS:
        shown = f"{said}, {_LARGEST if largest else MOMENTS[AT_MAX]}"
        yield Variable(name, _TRIAL, unit, shown)
        if has_std:
            yield Variable(f"{name}_std", _TRIAL, unit, f"standard deviation of {name}, by the errors of the points")
        for moment, when in MOMENTS.items():
            if moment == AT_MAX and not largest:
                continue
            yield Variable(f"{name}_{moment}", _TRIAL, unit, f"{said}, {when}")
            if has_std:
                yield Variable(f"{name}_{moment}_std", _TRIAL, unit, f"standard deviation of {name}_{moment}")
    for name in NORMALISED:
        yield Variable(f"{name}_normalised", _TRIAL, "1", f"{name} over its median in the participant's trials")


#: Numeric columns of a trial.
NUMBERS: dict[str, Variable] = {variable.name: variable for variable in _all()}
#: Other columns of a trial.
FACTS: dict[str, Variable] = {
    name: Variable(name, _TRIAL, "1", said)
    for name, said in {
        "status": "measured, failed (no result), or not run",
        "reason": "why a trial has no result",
        "slip_verdict": "how the stuck area vanishes, of trials of tangential loading",
        "frames": "frames that count",
        "usable_frames": "frames that are pictures of the trial (frame_status)",
        "warnings": "sentences of the result's warnings, one a line",
        "recording": "file of the frames, relative to the study",
        "result": "file of the result, relative to the study",
    }.items()
}
OF_RESULTS = frozenset((*NUMBERS, *FACTS)) - {"recording"}
