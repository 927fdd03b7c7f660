"""Bodies of the page's requests: their fields and types."""

import json
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from fingerflow.errors import FingerflowError

Number = Annotated[int, Field(ge=0, lt=2**31)]


class Body(BaseModel):
    """Body of a request that has no fields of its own."""

    model_config = ConfigDict(strict=True)


class EditBody(Body):
    """Keys to set, with their values."""

    set: list[tuple[str, Any]]


class CalibrateBody(Body):
    """Pictures to calibrate from."""

    ring: str | None = None
    target: str | None = None
    background: str | None = None
    hole_radius_mm: FiniteFloat | None = None


class WriteBody(Body):
    """Where to write the scene."""

    to: str | None = None
    replace: bool = False


class ProcessBody(Body):
    """Whether to compute all variables."""

    all: bool = False


class EndBody(Body):
    """Which run to end."""

    of: str


class HistoryBody(Body):
    """Points whose history is shown."""

    key: str
    points: list[Number]


class TableBody(Body):
    """What a table is of."""

    of: str
    frame: Number = 0
    shown: str | None = None
    keys: list[str] = []
    points: list[Number] = []


def body_of(sent: bytes, kind: type[Body]) -> dict[str, Any]:
    """Return the fields of a body; raise FingerflowError, naming the field, for what is no JSON or of another type."""
    try:
        content = kind.model_validate_json(sent).model_dump()
    except ValidationError as error:
        first = error.errors()[0]
        if first["type"] == "json_invalid":
            raise FingerflowError("what was sent is no JSON") from None
        place = ".".join(map(str, first["loc"])) or "the body"
        raise FingerflowError(f"{place} of what was sent is wrong: {first['msg']}; reload the page") from None
    if r"\u0000" in json.dumps(content):
        raise FingerflowError("what was sent has a zero byte, which no name of a file or key can have; leave it out")
    return content
