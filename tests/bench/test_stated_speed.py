"""The pages state the speed that the committed rows have."""

from pathlib import Path

from bench.record import newest_suites
from bench.rows import number

ROOT = Path(__file__).parents[2]


def test_pages_state_the_times_of_the_rows() -> None:
    """README and docs/accuracy.md state the time of a frame and of a point, that of OpenCV, and the compiled share,
    as the rows have them, rounded.
    """
    pages = {name: " ".join((ROOT / name).read_text("utf-8").split()) for name in ("README.md", "docs/accuracy.md")}
    peer, ours = newest_suites()["pipeline"].suite["rows"]
    times = f"{number(ours, 'cpu_ms'):.1f} for {number(peer, 'cpu_ms'):.1f} ms a frame of one core"
    for page in pages.values():
        assert f"{number(ours, 'cpu_to_peer'):.2f} of" in page
        assert times in page
    assert f"{number(ours, 'compiled_share'):.2f} of it is spent in compiled kernels" in pages["docs/accuracy.md"]
    points = {(row["tracker"], row["window_px"]): row for row in newest_suites()["speed_against_error"].suite["rows"]}
    fast, default = (number(points["fingerflow, recorded", window], "us_per_point") for window in (11, 25))
    assert f"takes {fast:.2f} µs of processor time a frame with the fast settings" in pages["README.md"]
    assert f"{default:.2f} µs with the default ones" in pages["README.md"]
