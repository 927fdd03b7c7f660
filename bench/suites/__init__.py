"""One suite a module, found by its name.

A suite has a docstring that says what is measured and what the columns mean, and `run(quick) -> list[Row]`. It may have
`draw(rows, path)` for a figure. It raises `bench.rows.Skipped` with the reason where it cannot run.
"""
