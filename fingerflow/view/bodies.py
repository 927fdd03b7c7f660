"""Fields and types of the JSON bodies of requests from the page."""

import json
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from fingerflow.errors import FingerflowError

Number = Annotated[int, Field(ge=0, lt=2**31)]


class Body(BaseModel):
    """Body of a request without any fields; base class of all other bodies."""

    model_config = ConfigDict(strict=True)


class EditBody(Body):
    """Body of a request to edit the scene: keys to set, with their values."""

    set: list[tuple[str, Any]]


class CalibrateBody(Body):
    """Body of a calibration request: image files, the radius of the hole of the calibration ring, and the inner corners
    in a row and in a column of the chessboard.
    """

    ring: str | None = None
    target: str | None = None
    background: str | None = None
    chessboard: str | None = None
    corners: list[int] | None = None
    hole_radius_mm: FiniteFloat | None = None


class WriteBody(Body):
    """Body of a write request: where to write the scene file, and whether to replace an existing one."""

    to: str | None = None
    replace: bool = False


class ProcessBody(Body):
    """Body of a request to process the scene: whether to compute also variables that are computed only on request."""

    all: bool = False


class EndBody(Body):
    """Body of a request to end a running command: its name, `process` or `report`."""

    of: str


class HistoryBody(Body):
    """Body of a request for time series: one variable at selected points."""

    key: str
    points: list[Number]


class TableBody(Body):
    """Body of a request for a CSV table: values of one frame, or time series with the median over selected points."""

    of: str
    frame: Number = 0
    shown: str | None = None
    keys: list[str] = []
    points: list[Number] = []


def parse_body(sent: bytes, model: type[Body]) -> dict[str, Any]:
    """Return the fields of a JSON request body; raise FingerflowError for invalid JSON or a field of wrong type."""
    try:
        content = model.model_validate_json(sent).model_dump()
    except ValidationError as error:
        first = error.errors()[0]
        if first["type"] == "json_invalid":
            raise FingerflowError("what was sent is no JSON") from None
        field = ".".join(map(str, first["loc"])) or "the body"
        raise FingerflowError(f"{field} of what was sent is wrong: {first['msg']}; reload the page") from None
    refuse_zero_bytes(content)
    return content


def refuse_zero_bytes(content: Any) -> None:
    """Raise FingerflowError if a text in the fields of a request has a zero byte."""
    if r"\u0000" in json.dumps(content):
        raise FingerflowError("what was sent has a zero byte, which no name of a file or key can have; leave it out")
