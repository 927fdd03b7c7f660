"""Test that every measured number of results and of the table of trials has a standard deviation, and every deviation
its number.
"""

from fingerflow.schema.trial_columns import NUMBERS
from fingerflow.schema.variables import VARIABLES

#: Numbers without a variable of their own for the deviation, after the reason.
WITHOUT = {
    "of sensors and clocks, which state no error": "time latency normal_force tangential_force tangential_direction "
    "load_ratio force_angle actuator_position max_force time_to_max_force duration force_rate friction friction_force",
    "chosen from the picture; what they do to areas is in theirs": "contact_threshold illumination_gain",
    "position_std_px": "position position_px deformation_correction_px position_noise_px position_anisotropy",
    "displacement_std, and dense_flow_difference": "reference_position skin_displacement",
    "say how well something is measured": "subset_correlation forward_backward_error forward_backward_median "
    "tracked_share field_coverage window_differs_share slip_coverage dense_flow_difference dense_flow_difference_95 "
    "coverage longest_axis_ratio",
    "of one point, which is chosen": "max_displacement max_speed",
    "that of the area, over the same median": "real_contact_area_normalised gross_contact_area_normalised",
}
#: Variables of recordings and streams, and columns of trials.
ALL = VARIABLES | NUMBERS


def test_every_number_has_a_deviation_or_a_reason() -> None:
    """Variables that repeat a paper's own steps (printed_) are exempt. Columns of one quantity at several moments of a
    trial count as one.
    """
    numbers = {name for name, variable in ALL.items() if variable.dtype[0] == "f" and "_std" not in name}
    without = {name.partition("_at_")[0] for name in numbers if f"{name}_std" not in ALL}
    assert {name for name in without if not name.startswith("printed_")} == set(" ".join(WITHOUT.values()).split())


def test_every_deviation_has_its_number() -> None:
    """A deviation has the unit and the dimensions of its number; components that err alike share one."""
    for name, deviation in ALL.items():
        if name.endswith("_std"):
            number = ALL[name.removesuffix("_std")]
            assert deviation.dims in (number.dims, number.dims[:-1]), name
            assert deviation.shown_unit == number.shown_unit, name
            assert deviation.unasked == number.unasked, name
            assert deviation.equation or name in NUMBERS, name
