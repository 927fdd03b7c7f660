"""Definitions of the columns in a study's table of trials: name, unit and meaning, as listed in `variables.csv`.

Without a suffix a column is the value shown in figures; with `_at_1n`, `_at_onset` and so on it is the value at that
moment. `_std` is its standard deviation.
"""

from collections.abc import Iterator
from dataclasses import replace

from fingerflow.schema.variable_record import MICROMETRE, Variable, with_deviation
from fingerflow.schema.variables import VARIABLES, by_name

#: Moments of a trial, with their definitions in `MOMENTS`.
FORCES_N = (1.0, 2.0, 3.0)
AT_ONSET, AT_MAX = "at_onset", "at_max"
MOMENTS = {
    **{f"at_{force:g}n": f"when the normal force first reaches {force:g} N" for force in FORCES_N},
    AT_ONSET: "in the first frame with contact",
    AT_MAX: "at the largest normal force, without forces at the largest gross contact area",
}
_TRIAL = ("trial",)
_LARGEST = "the largest of the trial"


def _at_moments(
    name: str, variable: str, definition: str, largest: bool = False, label: str = ""
) -> Iterator[Variable]:
    """Yield the columns of a quantity that the table of trials lists at several moments of a trial, one per moment; the
    first has no suffix. A variable with a standard deviation gives columns of it, too.

    Args:
        name: of the column without a suffix.
        variable: of a result that has the same unit.
        definition: of the quantity.
        largest: whether the column without a suffix is the largest value of the trial, else the value at the maximum.
        label: on axes and in tables; "" for the name in words.
    """
    source = VARIABLES[variable]

    def column(name: str, definition: str, label: str = "") -> Variable:
        return Variable(name, _TRIAL, source.units, definition, shown_in=source.shown_in, of=(variable,), label=label)

    columns = [column(name, f"{definition}, {_LARGEST if largest else MOMENTS[AT_MAX]}", label)]
    moments = {moment: when for moment, when in MOMENTS.items() if largest or moment != AT_MAX}
    columns += [column(f"{name}_{moment}", f"{definition}, {when}") for moment, when in moments.items()]
    for value in columns:
        yield from with_deviation(value, of=value.of) if f"{variable}_std" in VARIABLES else (value,)


_QUANTITIES = tuple(tuple(columns) for columns in (
    _at_moments("real_contact_area", "real_contact_area", "real contact area"),
    _at_moments("gross_contact_area", "gross_contact_area", "gross contact area"),
    _at_moments("divergence", "median_divergence", "median divergence over the gross contact"),
    _at_moments("curl", "median_curl", "median curl over the gross contact"),
    _at_moments("strain", "median_strain", "median strain along the major axis that the gross contact has at its "
                "maximum", label="longitudinal strain"),
    _at_moments("strain_across", "median_strain", "median strain across that axis"),
    _at_moments("strain_energy", "strain_energy", "strain energy of the whole contact"),
    _at_moments("divergence_rate", "median_divergence_rate", "rate of the median divergence", largest=True),
    _at_moments("strain_rate", "median_strain_rate", "rate of the strain along the major axis", largest=True),
    _at_moments("strain_energy_rate", "strain_energy_rate", "rate of the strain energy", largest=True),
    _at_moments("global_displacement", "global_displacement", "length of the median displacement since onset",
                largest=True),
    _at_moments("force_angle", "force_angle", "angle of the force from the normal, atan |T/N|", largest=True,
                label="peak force angle"),
    _at_moments("coverage", "tracked_share", "share of the points in contact that are tracked"),
))  # fmt: skip
#: Variables of a result by the names of the quantities that the table lists at several moments.
AT_MOMENTS = {columns[0].name: columns[0].of[0] for columns in _QUANTITIES}
_OF_TRIAL = (
    Variable("max_force", _TRIAL, "N", "largest normal force", label="largest normal force"),
    Variable("time_to_max_force", _TRIAL, "s", "from the first frame with contact to the largest normal force",
             label="time to largest force"),
    Variable("duration", _TRIAL, "s", "from the first frame with contact to the last"),
    Variable("force_rate", _TRIAL, "N/s",
             "largest rate of the normal force from the first contact to the largest force",
             label="largest force rate"),
    Variable("max_displacement", _TRIAL, "mm",
             "largest displacement since onset: the 0.99 quantile over points in contact, so that one lost point does "
             "not decide", label="largest displacement", shown_in=MICROMETRE),
    Variable("max_speed", _TRIAL, "mm/s",
             "largest speed, up to the largest force, of the point that has that displacement", label="largest speed"),
    Variable("friction", _TRIAL, "1",
             "median T/N where no skin sticks any more; nothing where the finger did not slide"),
    Variable("friction_force", _TRIAL, "N", "median normal force there", label="normal force of the slide"),
    *with_deviation(Variable("contact_exponent", _TRIAL, "1",
        "n of gross contact area = k N^n from a tenth of the largest force up to it, areas over 3 mm² (Dzidek et al. "
        "2017; 2/3 of a sphere, Hertz)"), note=", leaving out each tenth"),
    *with_deviation(Variable("contact_time_constant", _TRIAL, "s",
        "τ of real contact area = a + b exp(−t/τ) while the normal force stays within 5 % of its largest (Dzidek et "
        "al. 2017); nothing where it does not show"), note=", by the residuals"),
    *with_deviation(Variable("unloading_area_ratio", _TRIAL, "1",
        "gross contact area at half of the largest force, when it last falls through it over when it first rises to "
        "it"), note=", areas independent"),
    *with_deviation(Variable("full_slip_load_ratio", _TRIAL, "1", "T/N just before the last skin slips"),
        note=", by its noise from frame to frame"),
    *with_deviation(Variable("full_slip_time", _TRIAL, "s",
        "from where T/N is last under a twentieth of its value at full slip to where the last skin slips"),
        note=", by noise of d² and by frames"),
    *with_deviation(Variable("full_slip_displacement", _TRIAL, "mm",
        "median displacement of the skin in contact over that time", shown_in=MICROMETRE),
        note=", by that of the time"),
    *with_deviation(Variable("tangential_stiffness", _TRIAL, "N/mm",
        "slope of the tangential force over the position of the actuator, from a twentieth of T/N at full slip to "
        "where d² first falls under 0.9: skin and bone in series (Nakazawa et al. 2000)"), note=", by residuals"),
    Variable("longest_axis_ratio", _TRIAL, "1",
             "major over minor axis of the gross contact at its maximum: near 1 the directions along and across are "
             "chance"),
)  # fmt: skip
#: Suffix of a curve while the normal force falls.
UNLOADING = "_unloading"
#: Curves against a share of the load: of T/N at full slip for d², else of the largest normal force.
BY_SHARE = by_name((
    replace(VARIABLES["stuck_ratio"], label="stick ratio d²"),
    Variable("relative_area", _TRIAL, "1", "gross area over that at the largest force", label="relative contact area"),
    Variable("mean_pressure", _TRIAL, "kPa", "normal force over gross contact area"),
))  # fmt: skip
#: Areas that are also given relative to their median over the participant's trials, when the table is written.
NORMALISED = ("real_contact_area", "gross_contact_area")


#: Numeric columns of the table of trials.
NUMBERS = by_name(
    _OF_TRIAL,
    *_QUANTITIES,
    (
        Variable(f"{name}_normalised", _TRIAL, "1", f"{name} over its median in the participant's trials")
        for name in NORMALISED
    ),
)
#: Differences from the reference trial, added when the table is written, for trials that name one.
DIFFERENCE = "_difference"
_COMPARED = [column for column in _OF_TRIAL if not column.name.endswith("_std")]
_COMPARED += [columns[0] for columns in _QUANTITIES]
DIFFERENCES = by_name(
    replace(column, name=f"{column.name}{DIFFERENCE}", long_name=f"{column.long_name}; less that of the reference")
    for column in _COMPARED
)
_FACTS = {
    "status": "measured, failed (no result), or not run",
    "reason": "why a trial has no result",
    "slip_verdict": "how the stuck area vanishes, of trials of tangential loading",
    "frames": "frames that count",
    "usable_frames": "frames that are pictures of the trial (frame_status)",
    "warnings": "sentences of the result's warnings, one a line",
    "recording": "file of the frames, relative to the study",
    "result": "file of the result, relative to the study",
}
#: Columns of the table of trials that are not numeric.
FACTS = by_name(Variable(name, _TRIAL, "1", meaning) for name, meaning in _FACTS.items())
OF_RESULTS = frozenset((*NUMBERS, *DIFFERENCES, *FACTS)) - {"recording"}
