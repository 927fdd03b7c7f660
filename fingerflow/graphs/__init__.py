"""Torch modules made of ops: exactly what runs for a batch of frames, for any device, without hidden state."""

from fingerflow.graphs.contact import Contact, ContactGraph
from fingerflow.graphs.fields import Fields, FieldsGraph, GrossEllipse, SkinFields, SkinFieldsGraph
from fingerflow.graphs.light import Light, LightGraph
from fingerflow.graphs.track import TrackGraph

__all__ = [
    "Contact",
    "ContactGraph",
    "Fields",
    "FieldsGraph",
    "GrossEllipse",
    "Light",
    "LightGraph",
    "SkinFields",
    "SkinFieldsGraph",
    "TrackGraph",
]
