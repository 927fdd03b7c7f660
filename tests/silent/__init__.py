"""Tables of cases in which a number could be wrong in silence: `python -m tests.silent GROUP`."""
