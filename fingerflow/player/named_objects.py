"""Import of optional libraries, and of functions from a user's own module, given as ``module:name``."""

import importlib
import os
import sys
from collections.abc import Callable
from typing import Any

from fingerflow.errors import PlayerError


def load_library(module: str, package: str) -> Any:
    """Import and return a module of an optional library; raise ImportError with the name of the package to install."""
    try:
        return importlib.import_module(module)
    except (ImportError, RuntimeError):  # RuntimeError: pylsl is installed without its library liblsl
        raise ImportError(name=package) from None


def load_callable(name: str) -> Callable[..., Any]:
    """Import and return the function or other callable that a text ``module:name`` means, from a module in the present
    folder or an installed one.

    Raises PlayerError where it cannot be imported, or cannot be called.
    """
    module, _, called = name.partition(":")
    sys.path.insert(0, os.getcwd())
    try:
        called_object = getattr(importlib.import_module(module), called)
    except (ImportError, AttributeError, ValueError) as error:
        raise PlayerError(f"{error}; give MODULE:FACTORY of a module in this folder") from None
    finally:
        sys.path.pop(0)
    if not callable(called_object):
        raise PlayerError(f"{called} of {module} is {type(called_object).__name__}; it must be callable")
    return called_object
