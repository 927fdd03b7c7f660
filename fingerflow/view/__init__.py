"""Local web page to set up scenes and view results (`fingerflow view`), served to this computer only."""

from fingerflow.errors import FingerflowError

try:
    from fingerflow.view.server import serve
except ModuleNotFoundError as error:
    if error.name not in ("starlette", "uvicorn", "tomlkit"):
        raise
    raise FingerflowError(
        f"the page needs {error.name}, which is not installed: pip install starlette uvicorn tomlkit"
    ) from None

__all__ = ["serve"]
