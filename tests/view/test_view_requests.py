"""Tests of requests that the page never sends: each is refused in a sentence, and none ends in an error of the
server.
"""

import json

import pytest
from test_view_guard import ask

from fingerflow.view.draft import Draft
from fingerflow.view.server import Served

BODIES = [
    b"", b"{", b"[]", b"5", b"null", b"[" * 100_000, b"\xff\xfe", b"{}", b'{"set": 5}', b'{"set": [5]}',
    b'{"set": [["a"]]}', b'{"set": [["recording.frame_rate", {"a": 1}]]}', b'{"set": [["a.b", [[1, "a"], null]]]}',
    b'{"set": [["recording.frames", "\\u0000"]]}', b'{"set": [["recording.frames", "\\ud800"]]}',
    b'{"ring": 5}', b'{"ring": "frames.npy", "hole_radius_mm": "x"}', b'{"to": []}', b'{"to": "\\u0000"}',
    b'{"key": "position", "points": 5}', b'{"key": "position", "points": [99999999999999999999999]}',
    b'{"of": "frame", "frame": "x"}', b'{"of": "frame", "frame": 1, "shown": "real_contact_area"}', b'{"of": 5}',
    b'{"of": "courses", "keys": 5}',
]  # fmt: skip
POSTS = ("edit", "calibrate", "write", "process", "end", "result/history", "result/table")
GETS = ("frame?frame=--5", "frame?frame=%C2%B2", f"result/frame?frame={'1' * 5000}", "result/range?key=xy",
        "folder?at=%00", "folder?at=a%00b", "progress?of=%00", "result/range?key=%00",
        f"folder?at={'x' * 5000}")  # fmt: skip
# Values that the rules of a scene report as problems; the page can still ask for everything about the draft.
VALUES = [
    ["recording", 5], ["forces", 3], ["calibration", 7], ["views", [1]], ["recording.frame_rate", 2.3e-308],
    ["recording.frame_rate", 1e308], ["recording.frame_rate", {"toml": "nan"}], ["forces.file", "a" * 5000],
    ["calibration.file", "."],
]  # fmt: skip


@pytest.fixture(scope="module")
def own(served: Served) -> dict[str, str]:
    """Return the headers that requests of the page carry."""
    return {"X-Fingerflow": served.address.partition("/#token=")[2]}


def test_what_no_page_sends_is_refused_in_a_sentence(served: Served, own: dict[str, str]) -> None:
    told = 0
    for path in POSTS:
        for body in BODIES:
            status, _, said = ask(served, f"/api/{path}", "POST", body.decode("latin-1"), **own)
            assert status in (200, 422), (path, body[:60], status)
            if status == 422:
                told += bool(json.loads(said)["error"])
    assert told > 140
    for path in GETS:
        status, _, said = ask(served, f"/api/{path}", **own)
        assert (status, bool(json.loads(said)["error"])) == (422, True), path


@pytest.mark.parametrize("value", VALUES, ids=lambda value: value[0])
def test_values_that_cannot_be_are_problems_of_the_draft(
    served: Served, own: dict[str, str], value: list[object]
) -> None:
    draft = served.session._draft
    assert draft is not None
    served.session._draft = Draft.read(draft.path)
    status, _, said = ask(served, "/api/edit", "POST", json.dumps({"set": [value]}), **own)
    facts = json.loads(said)
    assert status == 200
    assert facts["problems"] or facts["recording_error"]
    for path in ("setup", "frame?frame=1&contact=1", "points", "forces", "calibration.png"):
        assert ask(served, f"/api/{path}", **own)[0] in (200, 404, 422), path
