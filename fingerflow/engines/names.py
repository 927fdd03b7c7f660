"""Names of the graphs of a bundle."""

#: Graphs of a bundle that an engine needs, in the order in which they can run.
GRAPHS = (
    "light",
    "contact",
    "threshold",
    "noise",
    "detect",
    "spline",
    "prepare",
    "renew",
    "track",
    "track_few",
    "support",
    "correct",
    "outliers",
    "search",
    "windows",
    "fields",
    "fields_entered",
    "fit",
)
