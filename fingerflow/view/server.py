"""HTTP server of the page, which passes requests to a session."""

import json
import os
import socket
import threading
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any, Self

import uvicorn
from pydantic import TypeAdapter, ValidationError
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from fingerflow.errors import FingerflowError
from fingerflow.schema.json_value import json_value
from fingerflow.schema.variable_record import IN_PERCENT
from fingerflow.schema.variables import VARIABLES
from fingerflow.view.connection import Connection
from fingerflow.view.draft import NeedsLeaveError
from fingerflow.view.guard import Guard
from fingerflow.view.key_forms import reword
from fingerflow.view.open_path import open_path
from fingerflow.view.session import Session

_HOST = "127.0.0.1"
_PAGE = Path(__file__).with_name("page")
#: Settings of uvicorn: no log of requests, web sockets, events of the application or headers of a proxy.
_PLAIN: dict[str, Any] = {
    "log_level": "warning",
    "access_log": False,
    "ws": "none",
    "lifespan": "off",
    "proxy_headers": False,
}
_BINARY, _CSV = "application/octet-stream", "text/csv; charset=utf-8"
_REPORT_MAY = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "frame-ancestors 'none'"
)


class Served:
    """Running server of the page; use as a context manager, or call `run`.

    Attributes:
        address: URL that opens the page, with its token.
    """

    def __init__(self, path: Path | None, port: int = 0) -> None:
        """Open a path and bind a port (0 for a free one); raise FingerflowError if either fails."""
        self.session = Session(*open_path(path))
        self.session.open()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._socket.bind((_HOST, port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise FingerflowError(f"port {port} of {_HOST} cannot be served ({error}); give another --port") from None
        self._socket.listen()  # requests that arrive before the server runs wait in the queue
        self.port: int = self._socket.getsockname()[1]
        guard = Guard(application(self.session), self.port)
        self.address = f"http://{_HOST}:{self.port}/#token={guard.token}"
        self._server = uvicorn.Server(uvicorn.Config(guard, http=Connection, **_PLAIN))

    def run(self) -> None:
        """Serve the page until interrupted, then close the session."""
        try:
            self._server.run(sockets=[self._socket])
        finally:
            self.session.close()

    def __enter__(self) -> Self:
        """Start serving the page in a separate thread."""
        self._thread = threading.Thread(target=self.run, name="view")
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.should_exit = True
        self._thread.join(30)


def serve(path: Path | None, port: int = 0, opened: Callable[[str], Any] = print) -> None:
    """Serve the page of a scene, a recording or a result to this computer until interrupted.

    Args:
        path: scene, recording or result; None for scene.toml in the current folder.
        port: 0 for a free one.
        opened: called with the address once the port accepts connections.

    Raises:
        FingerflowError: the path cannot be opened, or the port is taken.
    """
    served = Served(path, port)
    opened(served.address)
    served.run()


def application(session: Session) -> Starlette:
    """Return the web application with all routes, without access control, which `Guard` adds."""

    def calibration() -> Response:
        picture = session.calibration_picture()
        return Response(status_code=404) if picture is None else Response(picture, media_type="image/png")

    def report() -> Response:
        page = session.report_page()
        # Sandbox the report: whatever it contains, it can send no requests and does not share the origin of this page.
        rules = {"Content-Security-Policy": _REPORT_MAY}
        return Response(status_code=404) if page is None else Response(page, media_type="text/html", headers=rules)

    # Answered also while another request, which takes long, holds the lock of the session.
    at_once = ("ready", "variables", "percent", "folder", "end", "progress")

    def route(path: str, act: Callable[..., Any], method: str = "GET") -> Route:
        """Return a route that calls `act` with the fields of a request, checked by the types of its arguments: those of
        the JSON body of a POST, or of the query of a GET.
        """
        # Made of a function, it checks the arguments and calls the function; its stub declares types alone.
        checked: TypeAdapter[Any] = TypeAdapter(act)  # type: ignore[arg-type]

        def answer(sent: bytes) -> Any:
            with session.lock if path.removeprefix("/api/") not in at_once else nullcontext():
                return checked.validate_json(sent)

        async def endpoint(request: Request) -> Response:
            sent = await request.body() if method == "POST" else json.dumps(dict(request.query_params)).encode()
            if rb"\u0000" in sent:
                raise FingerflowError("what was sent has a zero byte, which no name of a file or key can have")
            return _response(await run_in_threadpool(answer, sent))

        return Route(path, endpoint, methods=[method])

    read = (
        *(session.ready, session.setup, session.folder, session.frame, session.points, session.forces),
        *(session.progress, session.result, session.result_frame, session.result_range, session.result_triangles),
    )
    sent = (
        *(session.edit, session.calibrate, session.write, session.process, session.end, session.report),
        *(session.result_courses, session.result_history, session.result_table),
    )
    of_session = [*((act, "GET") for act in read), *((act, "POST") for act in sent)]
    routes = [
        *(route(f"/api/{act.__name__.replace('_', '/')}", act, method) for act, method in of_session),
        route("/api/variables", _variables),
        route("/api/percent", _switch_unit, "POST"),
        route("/api/calibration.png", calibration),
        route(f"/{session.report_name}", report),
        Mount("/", StaticFiles(directory=_PAGE, html=True)),
    ]
    errors = (FingerflowError, OSError, ValidationError)
    return Starlette(routes=routes, exception_handlers=dict.fromkeys(errors, _refused))


def _variables() -> dict[str, dict[str, object]]:
    return {name: variable.shown() for name, variable in VARIABLES.items()}


def _switch_unit() -> dict[str, dict[str, object]]:
    """Switch the unit in which the page and all that it writes show deformation between its own unit and %; return the
    variables with their units as shown.
    """
    os.environ[IN_PERCENT] = "0" if os.environ.get(IN_PERCENT) == "1" else "1"
    return _variables()


def _response(answer: Any) -> Response:
    if isinstance(answer, Response):
        return answer
    if isinstance(answer, bytes):
        return Response(answer, media_type=_BINARY)
    if isinstance(answer, str):
        return Response(answer, media_type=_CSV)
    return JSONResponse(json_value(answer))


async def _refused(_: Request, error: Exception) -> Response:
    text = reword(str(error))
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        field = ".".join(map(str, first["loc"])) or "the whole"
        text = f"{field} of what was sent is wrong: {first['msg']}; reload the page"
    asks = {"asks": True} if isinstance(error, NeedsLeaveError) else {}
    return JSONResponse({"error": text, **asks}, 409 if asks else 422)
