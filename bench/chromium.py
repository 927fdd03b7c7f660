"""Chromium browser for benchmarks of web pages: Playwright's own, or the system's."""

import shutil
from pathlib import Path
from typing import Any


def launch(engine: Any) -> Any | None:
    """Return the browser, started without a window; None where there is neither."""
    own = Path(engine.chromium.executable_path)
    system = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if not own.exists() and system is None:
        return None
    return engine.chromium.launch(executable_path=None if own.exists() else system, args=["--no-sandbox"])
