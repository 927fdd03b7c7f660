"""Numbers as text, rounded to their uncertainty."""

import math

_NOTHING = 1e-9  # share of a value below which a deviation is rounding error


def format_uncertainty(value: float, spread: float = math.nan) -> str:
    """Return "value ± spread" as text, rounded to two significant digits of the spread (a standard deviation), or the
    value alone with three digits if the spread is unknown.

    >>> format_uncertainty(33.4123, 0.5178)
    '33.41 ± 0.52'
    """
    if not math.isfinite(value):
        return "–"
    if not math.isfinite(spread) or spread <= _NOTHING * abs(value):
        return _rounded(value, _decimals(abs(value), 3) if value else 0)
    digits = _decimals(spread, 2)
    return f"{_rounded(value, digits)} ± {_rounded(spread, digits)}"


def format_interval(value: float, low: float, high: float) -> str:
    """Return "value (low to high)" rounded to two digits of half the interval's width; without interval, the value.

    >>> format_interval(0.8312, 0.7344, 0.9018)
    '0.831 (0.734 to 0.902)'
    """
    half = (high - low) / 2
    if not math.isfinite(value) or not math.isfinite(half) or half <= 0:
        return format_uncertainty(value)
    digits = _decimals(half, 2)
    return f"{_rounded(value, digits)} ({_rounded(low, digits)} to {_rounded(high, digits)})"


def _decimals(size: float, digits: int) -> int:
    """Return the number of decimals with which a positive number has `digits` significant digits after rounding."""
    return digits - 1 - int(f"{size:.{digits - 1}e}".partition("e")[2])


def _rounded(value: float, decimals: int) -> str:
    return f"{round(value, decimals) + 0.0:.{max(decimals, 0)}f}"
