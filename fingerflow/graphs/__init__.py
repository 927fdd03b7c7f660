"""Torch modules (graphs) composed of tensor ops, for computations on batches of frames on any device."""

from fingerflow.graphs.contact_graph import Contact, ContactGraph
from fingerflow.graphs.detect import DetectGraph
from fingerflow.graphs.fields_graph import Entered, Fields, FieldsGraph, GrossEllipse
from fingerflow.graphs.image_steps import MedianFilter, NormalizeIllumination
from fingerflow.graphs.track import KeyGraph, TrackGraph

__all__ = [
    "Contact",
    "ContactGraph",
    "DetectGraph",
    "Entered",
    "Fields",
    "FieldsGraph",
    "GrossEllipse",
    "KeyGraph",
    "MedianFilter",
    "NormalizeIllumination",
    "TrackGraph",
]
