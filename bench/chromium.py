"""The browser that pages are looked at with: Playwright's own Chromium, or the system's."""

import shutil
from pathlib import Path
from typing import Any


def launch(engine: Any) -> Any | None:
    """Starts it, headless; None where there is neither."""
    own = Path(engine.chromium.executable_path)
    system = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if not own.exists() and system is None:
        return None
    return engine.chromium.launch(executable_path=None if own.exists() else system, args=["--no-sandbox"])
