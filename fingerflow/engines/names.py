"""Names of the graphs of a deployment bundle."""

from typing import Literal, get_args

GraphName = Literal[
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
]
#: In an order in which an engine can run them.
GRAPHS: tuple[GraphName, ...] = get_args(GraphName)
