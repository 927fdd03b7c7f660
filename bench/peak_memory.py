"""Peak memory of `fingerflow.process`, in a process of its own: `python -m bench.peak_memory memory SCENE...` prints
JSON; with `file` results go to one."""

import json
import sys
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Self

from fingerflow import load_scene, process

STATUS = Path("/proc/self/status")  # Linux only


def sizes_of(process: int | str = "self") -> dict[str, int]:
    """Bytes of a process's own memory, RssAnon, and of all that is resident, VmRSS."""
    lines = (line.split(":") for line in (STATUS.parents[1] / str(process) / STATUS.name).read_text().splitlines())
    return {name: 1024 * int(rest.split()[0]) for name, rest in lines if name in ("RssAnon", "VmRSS")}


class Watch:
    """The largest memory that was seen, looking every few ms: bytes that are the process's own, and all resident ones.

    Pages of a mapped file are resident too, until the system has another use for them; they are not its own.
    """

    def __init__(self) -> None:
        self.own = self.resident = 0
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._done.set()
        self._thread.join()

    def _look(self) -> None:
        while True:
            sizes = sizes_of()
            self.own = max(self.own, sizes["RssAnon"])
            self.resident = max(self.resident, sizes["VmRSS"])
            if self._done.wait(0.005):
                return


def main(to: str, scenes: list[str]) -> None:
    """Every scene with all its outputs, after the first has been through once to load and cache what is kept."""
    loaded = [load_scene(Path(path)) for path in scenes]
    file = Path(scenes[0]).parent / "result.h5" if to == "file" else None
    process(loaded[0], device="cpu", to=file).close()
    found = []
    for scene in loaded:
        start = time.perf_counter()
        with Watch() as watch:
            result = process(scene, device="cpu", to=file)
        found.append(
            {
                "seconds": time.perf_counter() - start,
                "own_bytes": watch.own,
                "resident_bytes": watch.resident,
                "result_bytes": result.nbytes,
                "points": result.sizes["point"],
            }
        )
        result.close()
        del result
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
