"""Opening of what a user names by an address such as "udp:127.0.0.1:5005" (an output, force sensor or camera): the word
before the colon selects one of the modules of a folder.
"""

import pkgutil
from importlib import import_module
from typing import Any

from fingerflow.errors import FingerflowError, PlayerError, first_line


def kinds(package: str) -> dict[str, Any]:
    """Return the modules of a package that open addresses, by the word that begins these addresses, such as "udp"; in
    alphabetical order of the modules.

    Such a module has `ADDRESS`, the form of an address such as "udp:HOST:PORT", and `open_address`, which takes an
    address without its kind; of outputs the units of their values too. Its ImportError names the package to install.
    """
    files = pkgutil.iter_modules(import_module(package).__path__)
    modules = [import_module(f"{package}.{module.name}") for module in files]
    return {module.ADDRESS.partition(":")[0]: module for module in modules if hasattr(module, "ADDRESS")}


def forms(package: str) -> str:
    """Return the forms of the addresses that a package can open, such as "osc:HOST:PORT, udp:HOST:PORT", for error
    messages.
    """
    return ", ".join(module.ADDRESS for module in kinds(package).values())


def open_address(package: str, what: str, requested: str, *arguments: Any) -> Any:
    """Open and return the output, force sensor or camera with the address `requested`, by the module of a package that
    its first word names; `what` names the object in error messages.

    Raises PlayerError with the reason where there is no such kind or it cannot be opened.
    """
    name, _, address = requested.partition(":")
    module = kinds(package).get(name)
    if module is None:
        raise PlayerError(f"{what} {requested!r}: there is no kind {name!r}; give one of {forms(package)}")
    try:
        return module.open_address(address, *arguments)
    except FingerflowError as error:
        raise PlayerError(f"{what} {requested!r}: {error}; its form is {module.ADDRESS}") from None
    except ImportError as error:
        raise PlayerError(f"{what} {requested!r}: needs the package {error.name}: `pip install {error.name}`") from None
    except (Exception, SystemExit) as error:  # a user's or library's code may raise anything
        raise PlayerError(f"{what} {requested!r}: cannot be opened ({first_line(error)})") from error
