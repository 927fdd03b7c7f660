"""Torch modules (graphs) composed of tensor ops, for computations on batches of frames on any device."""

from fingerflow.graphs.contact_graph import Contact, ContactGraph
from fingerflow.graphs.fields_graph import Entered, Fields, FieldsGraph, GrossEllipse
from fingerflow.graphs.image_steps import MedianFilter, NormalizeIllumination
from fingerflow.graphs.key import KeyGraph
from fingerflow.graphs.light import Light, LightGraph
from fingerflow.graphs.track import AgreementGraph, DeformationGraph, TrackGraph

__all__ = [
    "AgreementGraph",
    "Contact",
    "ContactGraph",
    "DeformationGraph",
    "Entered",
    "Fields",
    "FieldsGraph",
    "GrossEllipse",
    "KeyGraph",
    "Light",
    "LightGraph",
    "MedianFilter",
    "NormalizeIllumination",
    "TrackGraph",
]
