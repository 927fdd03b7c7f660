"""Mistakes and damage that must not give wrong results without a warning: `python -m tests.silent GROUP` prints a
table.
"""
