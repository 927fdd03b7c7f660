"""HTTP server of the page, which passes requests to a session."""

import os
import re
import socket
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self

import uvicorn
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
from fingerflow.view import bodies
from fingerflow.view.bodies import Body, parse_body
from fingerflow.view.connection import Connection
from fingerflow.view.draft import NeedsLeaveError
from fingerflow.view.guard import Guard
from fingerflow.view.key_forms import reword
from fingerflow.view.open_path import open_path
from fingerflow.view.session import Session

_HOST = "127.0.0.1"
_PAGE = Path(__file__).with_name("page")
_BINARY, _CSV = "application/octet-stream", "text/csv; charset=utf-8"
_REPORT_MAY = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "frame-ancestors 'none'"
)
Answer = Callable[[Request], Any]


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
        config = uvicorn.Config(
            guard,
            http=Connection,
            log_level="warning",
            access_log=False,
            ws="none",
            lifespan="off",
            proxy_headers=False,
        )
        self._server = uvicorn.Server(config)

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

    def number(request: Request, name: str) -> int:
        text = request.query_params.get(name, "")
        if not re.fullmatch(r"-?[0-9]{1,18}", text):
            raise FingerflowError(f"{name}={text[:40]!r} is no number of a frame")
        return int(text)

    def frame(request: Request) -> bytes:
        return session.frame(number(request, "frame"), "contact" in request.query_params)

    def result_frame(request: Request) -> bytes:
        query = request.query_params
        return session.result_frame(number(request, "frame"), query.get("shown") or None, "contact" in query)

    def calibration(_: Request) -> Response:
        picture = session.calibration_picture()
        return Response(status_code=404) if picture is None else Response(picture, media_type="image/png")

    def report(_: Request) -> Response:
        page = session.report_page()
        # Sandbox the report: whatever it contains, it can send no requests and does not share the origin of this page.
        rules = {"Content-Security-Policy": _REPORT_MAY}
        return Response(status_code=404) if page is None else Response(page, media_type="text/html", headers=rules)

    routes = [
        Route("/api/ready", _get(lambda _: session.ready())),
        Route("/api/variables", _get(_variables)),
        Route("/api/percent", _post(_switch_unit, Body), methods=["POST"]),
        Route("/api/setup", _get(lambda _: session.setup())),
        Route("/api/folder", _get(lambda request: session.folder(request.query_params.get("at", "")))),
        Route("/api/frame", _get(frame)),
        Route("/api/points", _get(lambda _: session.points())),
        Route("/api/forces", _get(lambda _: session.forces())),
        Route("/api/calibration.png", _get(calibration)),
        Route("/api/edit", _post(session.edit, bodies.EditBody), methods=["POST"]),
        Route("/api/calibrate", _post(session.calibrate, bodies.CalibrateBody), methods=["POST"]),
        Route("/api/write", _post(session.write, bodies.WriteBody), methods=["POST"]),
        Route("/api/process", _post(session.process, bodies.ProcessBody), methods=["POST"]),
        Route("/api/end", _post(session.end, bodies.EndBody), methods=["POST"]),
        Route("/api/report", _post(session.report, Body), methods=["POST"]),
        Route("/api/progress", _get(lambda request: session.progress(request.query_params.get("of", "")))),
        Route(f"/{session.report_name}", _get(report)),
        Route("/api/result", _get(lambda _: session.result())),
        Route("/api/result/frame", _get(result_frame)),
        Route("/api/result/range", _get(lambda request: session.result_range(request.query_params.get("key", "")))),
        Route("/api/result/triangles", _get(lambda _: session.triangles())),
        Route("/api/result/courses", _get(lambda request: session.courses(request.query_params.getlist("key")))),
        Route("/api/result/history", _post(session.history, bodies.HistoryBody), methods=["POST"]),
        Route("/api/result/table", _post(session.table, bodies.TableBody), methods=["POST"]),
        Mount("/", StaticFiles(directory=_PAGE, html=True)),
    ]
    handlers: Mapping[Any, Any] = {FingerflowError: _refused, OSError: _refused}
    return Starlette(routes=routes, exception_handlers=handlers)


def _variables(_: object) -> dict[str, dict[str, object]]:
    return {name: variable.shown() for name, variable in VARIABLES.items()}


def _switch_unit(_: object) -> dict[str, dict[str, object]]:
    """Switch the unit in which the page and all that it writes show deformation between its own unit and %; return the
    variables with their units as shown.
    """
    os.environ[IN_PERCENT] = "0" if os.environ.get(IN_PERCENT) == "1" else "1"
    return _variables(_)


def _get(answer: Answer) -> Callable[[Request], Any]:
    async def endpoint(request: Request) -> Response:
        bodies.refuse_zero_bytes(request.query_params.multi_items())
        return _response(await run_in_threadpool(answer, request))

    return endpoint


def _post(act: Callable[[Mapping[str, Any]], Any], model: type[Body]) -> Callable[[Request], Any]:
    async def endpoint(request: Request) -> Response:
        return _response(await run_in_threadpool(act, parse_body(await request.body(), model)))

    return endpoint


def _response(answer: Any) -> Response:
    if isinstance(answer, Response):
        return answer
    if isinstance(answer, bytes):
        return Response(answer, media_type=_BINARY)
    if isinstance(answer, str):
        return Response(answer, media_type=_CSV)
    return JSONResponse(json_value(answer))


async def _refused(_: Request, error: Exception) -> Response:
    asks = {"asks": True} if isinstance(error, NeedsLeaveError) else {}
    return JSONResponse({"error": reword(str(error)), **asks}, 409 if asks else 422)
