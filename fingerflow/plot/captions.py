"""Captions of figures: where they are kept, and texts for frames and definitions of variables."""

from weakref import WeakKeyDictionary

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.figure import Figure, SubFigure

from fingerflow.schema.variable_record import Variable

_CAPTIONS: WeakKeyDictionary[Artist, str] = WeakKeyDictionary()


def describe(artist: Artist, caption: str) -> None:
    """Attach a caption to axes or a figure, for the caption file and the report."""
    _CAPTIONS[artist] = caption


def caption_of(figure: Figure | SubFigure) -> str:
    """Return the caption of a figure, else the joined captions of its axes; empty if there are none."""
    if figure in _CAPTIONS:
        return _CAPTIONS[figure]
    return " ".join(_CAPTIONS[axes] for axes in figure.axes if axes in _CAPTIONS)


def frame_text(frame: xr.Dataset) -> str:
    """Return a caption text with number, time and normal force of a frame."""
    words = [f"frame {int(frame['frame'])}", f"{float(frame['time']):.3f} s"]
    if "normal_force" in frame and np.isfinite(frame["normal_force"]):
        words.append(f"{float(frame['normal_force']):.2f} N")
    return ", ".join(words)


def definition_text(variable: Variable, more: str = "") -> str:
    """Return a sentence that defines a variable or column, for captions; `more` is appended to it."""
    words, meaning = variable.words, variable.long_name
    return f"{sentence(meaning if meaning.startswith(words) else f'{words}: {meaning}')}{more}."


def sentence(words: str) -> str:
    """Return a text with its first letter capitalised and all others unchanged."""
    return words[:1].upper() + words[1:]
