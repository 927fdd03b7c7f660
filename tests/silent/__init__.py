"""Mistakes and damages that must not be wrong in silence: `python -m tests.silent GROUP` prints a table of them."""
