"""Torch modules (graphs) composed of tensor ops, for computations on batches of frames on any device."""

from fingerflow.graphs.contact_graph import ContactGraph
from fingerflow.graphs.detect import DetectGraph
from fingerflow.graphs.fields_graph import FieldsGraph
from fingerflow.graphs.image_steps import MedianFilter, NormalizeIllumination
from fingerflow.graphs.track import KeyGraph, TrackGraph
from fingerflow.kernels.result_records import EnteredPoints, FrameContact, FrameEllipse, FrameFields

__all__ = [
    "ContactGraph",
    "DetectGraph",
    "EnteredPoints",
    "FieldsGraph",
    "FrameContact",
    "FrameEllipse",
    "FrameFields",
    "KeyGraph",
    "MedianFilter",
    "NormalizeIllumination",
    "TrackGraph",
]
