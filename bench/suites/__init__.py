"""Benchmark suites: one per module, with the name of the module.

The docstring of a suite states what is measured and what the columns mean; `run(quick) -> list[Row]` returns the rows.
`draw(rows, path)` is optional and draws a figure. `run` raises `bench.rows.Skipped` with the reason if it cannot run.
"""
