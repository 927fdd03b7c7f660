"""Captions of figures, and the letters of their panels."""

import string
from weakref import WeakKeyDictionary

from matplotlib.artist import Artist
from matplotlib.figure import FigureBase

_CAPTIONS: WeakKeyDictionary[Artist, str] = WeakKeyDictionary()


def describe(artist: Artist, caption: str) -> None:
    """Attach a caption to axes or to a figure: what is drawn, what bands mean, and the number of observations."""
    _CAPTIONS[artist] = caption


def caption_of(figure: FigureBase) -> str:
    """Return the caption of a figure, else those of its axes one after the other; empty if it has none."""
    if figure in _CAPTIONS:
        return _CAPTIONS[figure]
    return " ".join(_CAPTIONS[axes] for axes in figure.get_axes() if axes in _CAPTIONS)


def panel_letter(number: int) -> str:
    """Return the letter of a panel, counted from 0: A to Z, then AA, AB and so on.

    >>> [panel_letter(number) for number in (0, 25, 26, 27)]
    ['A', 'Z', 'AA', 'AB']
    """
    letters = string.ascii_uppercase
    before = panel_letter(number // len(letters) - 1) if number >= len(letters) else ""
    return before + letters[number % len(letters)]
