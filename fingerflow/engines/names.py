"""Names of the graphs of a deployment bundle."""

#: Graphs of a deployment bundle that an engine needs, in an order in which they can run.
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
