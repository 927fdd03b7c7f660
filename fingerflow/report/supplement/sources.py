"""Inputs of the supplement's figures, each read or simulated when first used and then kept."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fingerflow.models.friction_epochs import FrictionEpochs
from fingerflow.models.observer import FORCED_CHOICE, Trials
from fingerflow.report.press_field import PressField, press_field
from fingerflow.report.simulated_presses import SimulatedPresses, simulate_presses
from fingerflow.report.strains_at_depth import Depth, compute_strains_at_depth
from fingerflow.report.tribometer import TribometerTrace
from fingerflow.schema.trial_columns import DIFFERENCE
from fingerflow.synthetic import Press

NO_TRIALS = "a table of trials (--trials)"


@dataclass(frozen=True)
class Sources:
    """Inputs of the supplement's figures: tribometer trace and table of trials (None if not given), name of the
    experimental design, and simulations that are computed at first use.
    """

    tribometer: TribometerTrace | None = None
    trials: Trials | None = None
    design: str = FORCED_CHOICE  # design of the experiment: a name in GUESSES

    @cached_property
    def epochs(self) -> FrictionEpochs | None:
        """Return the friction coefficients in each epoch of the tribometer trace, a stretch of sliding in which the
        vibration amplitude rises; None without a trace.
        """
        return None if self.tribometer is None else self.tribometer.epochs()

    @cached_property
    def presses(self) -> SimulatedPresses:
        """Simulate the presses of the skin chain at several frictions."""
        return simulate_presses()

    @cached_property
    def depth(self) -> Depth:
        """Compute stress and strain below the skin surface in the simulated presses."""
        return compute_strains_at_depth(self.presses)

    @cached_property
    def field(self) -> PressField:
        """Compute the true displacement field of the simulated press."""
        return press_field(Press())

    def difference_column(self, metric: str) -> str:
        """Return the name of the column of the table of trials with a metric's difference from the reference trial, or
        the metric's own column if that one has no values.
        """
        column = metric + DIFFERENCE
        return metric if self.missing_input(column) else column

    def missing_input(self, *metrics: str) -> str:
        """Return text that names what is missing to draw these metrics, the table of trials or values in some of its
        columns; "" if nothing is.
        """
        if self.trials is None:
            return NO_TRIALS
        values = self.trials.metrics
        missing = [name for name in metrics if name not in values or not np.isfinite(values[name]).any()]
        return f"values of {', '.join(missing)} in the table of trials" if missing else ""
