"""Graphs of a recipe, in order of execution, and the units of all their inputs and outputs."""

from fingerflow.graphs.engine_graphs import LIGHT, SUPPORTS, Graph, engine_graphs
from fingerflow.kernels.result_records import FrameFields
from fingerflow.schema.recipe import GRAPHS, GraphName, Recipe

#: Unit of every input and output: px of the views, grey levels of the camera ("counts"), mm on the glass.
UNITS = {
    **dict.fromkeys(("contact_view", "topography_view", "key_view", "empty", "dark"), "counts"),
    **dict.fromkeys((*LIGHT, "noise", "spline", "samples"), "counts"),
    **dict.fromkeys(("points", "prediction", "estimate", "start", "found", "expected", "places", "shift"), "px"),
    **dict.fromkeys(("error", "position_std", "center", "semi_axes", "template_start", "neighbour_offset"), "px"),
    **dict.fromkeys(("real_area_px", "gross_area_px", "found_covariance"), "px^2"),
    **dict.fromkeys(("covariance", "variance"), "square of the unit of what varies"),
    **dict.fromkeys(
        (*FrameFields._fields, "gradient", "gradient_covariance", "threshold", "illumination_gain", "density_margin"),
        "1",
    ),
    **dict.fromkeys(("mask", "real_contact_mask", "status", "warp", "inverse_warp", "returns", "among"), "1"),
    **dict.fromkeys(("neighbour_number", "neighbour_within", *SUPPORTS), "1"),
    **dict.fromkeys(("off_neighbours", "uncertain"), "1"),
    **dict.fromkeys(("reference", "displacement", "queries", "gauge_length"), "mm"),
    **dict.fromkeys(("ellipse_center", "ellipse_semi_axes"), "mm"),
    **dict.fromkeys(("angle", "ellipse_angle"), "rad"),
    "response": "counts^2/px^2",
    "template_samples": "counts, counts/px",
    "template_numbers": "see kernels.tracking_limits.Number",
}


def build_graphs(recipe: Recipe) -> dict[GraphName, Graph]:
    """Build all graphs of a recipe, by name in order of execution, including graphs that are not exported."""
    graphs = engine_graphs(recipe.engine_settings, recipe.tracking.points)
    return {name: graphs[name] for name in GRAPHS}
