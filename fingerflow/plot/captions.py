"""Captions of figures."""

from weakref import WeakKeyDictionary

from matplotlib.artist import Artist
from matplotlib.figure import Figure, SubFigure

_CAPTIONS: WeakKeyDictionary[Artist, str] = WeakKeyDictionary()


def describe(artist: Artist, caption: str) -> None:
    """Attach a caption to axes or a figure, for the caption file and the report."""
    _CAPTIONS[artist] = caption


def caption_of(figure: Figure | SubFigure) -> str:
    """Return the caption of a figure, else the joined captions of its axes; empty if there are none."""
    if figure in _CAPTIONS:
        return _CAPTIONS[figure]
    return " ".join(_CAPTIONS[axes] for axes in figure.axes if axes in _CAPTIONS)
