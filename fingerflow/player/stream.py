"""One stream: its threads, and what passes between them."""

from __future__ import annotations

import logging
import math
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from .arrays import Array
from .bundle import Bundle
from .contract.pace import MOST_FRAMES
from .contract.variables import FRAME_STATUS
from .errors import PlayerError, first_line
from .findings import Findings
from .frame_check import USABLE, FrameCheck
from .handover import Channel, InOrder, Slot
from .latency import Latencies
from .live import Expected, Forces, LiveData, LiveViews
from .motion import count_known
from .page import serve_page
from .providers import PROVIDERS
from .records import RecordLayout
from .renewal import Pace
from .results import Sink
from .scene import Scene
from .settings import Settings
from .slip_flag import SlipFlag
from .sources.closing import close_within
from .sources.source import OpenSource, Source
from .stepper import Stepper
from .upkeep import REKEY, Change, Renewing, ThresholdSearch, Upkeep

log = logging.getLogger("fingerflow.player")

_STALL_WARNING = 2.0  # s
_HANGING = 2.0  # s that a stopped stream waits for its source before it is left behind
_REKEY_SHARE = 0.8
_PAGE = "page"  # somebody asked for other points
_TRACE_INTERVAL = 1 / 30  # s between points of the traces on the live page
_STORE_INTERVAL = 0.02  # s
_RECORDS_WAITING = 512  # more than a second's worth, as long as a slow disk may take to sync


class Player:
    """One stream from source to results; `run` returns when it has ended.

    Raises PlayerError for everything that the user can put right; the results are whole then too.
    """

    def __init__(
        self,
        stepper: Stepper,
        provider: str,
        bundle: Bundle,
        scene: Scene,
        source: Source,
        open_source: OpenSource,
        sink: Sink,
        layout: RecordLayout,
        settings: Settings,
        source_name: str = "source",
        expected: Expected | None = None,
        forces: Forces | None = None,
    ) -> None:
        self.bundle, self.scene, self.settings, self.source_name = bundle, scene, settings, source_name
        self.provider = provider
        self._stepper, self._sink, self._layout = stepper, sink, layout
        self._source, self._open_source = source, open_source
        # One slot is being filled, some computed, one is in doubt, one drawn on the page, one becomes the key frame;
        # the others wait. Their number is the bound.
        slots = [Slot(bundle) for _ in range(settings.queue + 4 + stepper.lag)]
        # The slot that was in use last is still in the processor's cache.
        self._free = Channel(len(slots), slots, newest_first=True)
        self._frames: Channel[Slot] = Channel(len(slots) if settings.every else 1)
        self._records: Channel[tuple[int, LiveViews | None]] = Channel(_RECORDS_WAITING)
        self._room = np.zeros(_RECORDS_WAITING + 2, layout.dtype)  # one is being filled, one written
        self._fields = {name: self._room[name] for name in self._room.dtype.names or ()}  # looked up once
        self.frames_in = self.processed = self.dropped = self.overruns = 0
        self.reconnects = self.stalls = self.restarts = self.keys = 0
        self.latencies, self._recent = Latencies(), Latencies()
        self.tracked = 0
        self.rate, self.recent = math.nan, self.latencies.summary()
        self.live = LiveData(bundle, expected, forces)
        self._state, self._said = "waiting", ""  # for the page
        self.restart_wanted = threading.Event()
        self._stop = threading.Event()
        self._finished = threading.Event()
        self._failure: BaseException | None = None
        self._waiting_since: float | None = None  # for the source
        self._computing = stepper.parallel  # threads
        self._beginning, self._order = threading.Lock(), InOrder(self._end, stepper.lag)
        self._first = math.nan
        self._check, self._findings = FrameCheck(stepper.glass, stepper.dark, bundle.bit_depth), Findings()
        self._in_doubt: tuple[Slot, int] | None = None  # a frame of which the next one says whether it counts
        self._unlooked, self._pace = 0, Pace(bundle.window_px)
        self._search = ThresholdSearch(stepper.lag)
        self._upkeep = Upkeep(scene.rekey_share or _REKEY_SHARE, scene.rekey_frames or math.inf)
        self._change: Change | None = None
        self._renewals: deque[Renewing] = deque()
        self._drawing = False  # a frame is on its way to the page
        self._slip = SlipFlag()
        self._topography_mm_per_px = scene.mm_per_px * math.sqrt(abs(np.linalg.det(scene.topography_to_contact[:, :2])))
        self._last_trouble = ""

    def run(self) -> dict[str, Any]:
        """Plays the stream and returns its summary."""
        after_computing = (self._free.close, self._frames.close, self._close_records)
        threads = [
            threading.Thread(target=self._guard, args=(step, after), name=step.__name__.strip("_"), daemon=True)
            for step, after in (
                (self._capture, (self._frames.close,)),
                *[(self._compute, after_computing)] * self._stepper.parallel,
                (self._store, (self._records.close, self._finished.set)),
            )
        ]
        self._started = time.perf_counter()
        address = self.settings.page
        page = None
        try:
            page = serve_page(address, self.live, self._said_by_page, self.restart_wanted.set) if address else None
            self._sink.open()
            log.info("results: %s, %.1f kB a frame", self._sink.folder, self._layout.dtype.itemsize / 1e3)
            for thread in threads:
                thread.start()
            self._watch()
            threads[0].join(_HANGING)
            self._frames.close()
            for thread in threads[1:]:
                thread.join()
        finally:
            self._seconds = time.perf_counter() - self._started
            if threads[0].ident is None:
                close_within(_HANGING, self._source)
            try:
                self._sink.close()
            except PlayerError as error:
                self._failure = self._failure or error
            if not self.processed:
                self._sink.discard()
            if page:
                failure = self._failure or sys.exc_info()[1]
                self._state, self._said = "failed" if failure else "ended", first_line(failure) if failure else ""
                page.stop()
        if self._failure is not None:
            raise self._failure
        missing = self._findings.missing(math.isfinite(self._stepper.threshold))
        for sentence in missing:
            log.warning("%s", sentence)
        return {**self.summary(), "warnings": missing}

    def stop(self) -> None:
        """Ends the stream cleanly; frames that came in are still processed."""
        self._stop.set()

    def points(self) -> dict[str, int]:
        """Points that the last frame tracked, of those chosen at the last restart."""
        return {"tracked": self.tracked, "found": self._stepper.found}

    def summary(self) -> dict[str, Any]:
        """Counts, seconds, rates and latencies until now."""
        seconds = getattr(self, "_seconds", time.perf_counter() - self._started)
        return {
            "frames_in": self.frames_in,
            "processed": self.processed,
            "dropped": self.dropped,
            "overruns": self.overruns,
            "reconnects": self.reconnects,
            "stalls": self.stalls,
            "restarts": self.restarts,
            "key_frames": self.keys,
            "not_usable": dict(self._findings.not_usable),
            "seconds": round(seconds, 3),
            "rate_hz": round(self.processed / seconds, 2),
            "latency_ms": self.latencies.summary(),
            "threshold": self._stepper.threshold if math.isfinite(self._stepper.threshold) else None,
            "results": str(self._sink.folder) if self.processed else None,
        }

    def _said_by_page(self) -> dict[str, Any]:
        return {
            "bundle": self.bundle.folder.resolve().name,
            "provider": PROVIDERS[self.provider],
            "mm_per_px": self.scene.mm_per_px,
            "topography_mm_per_px": self._topography_mm_per_px,
            "state": "running" if self._state == "waiting" and self.processed else self._state,
            "said": self._said,
            "fields": list(self._fields),
            "source": self.source_name,
            "rate": None if math.isnan(self.rate) else self.rate,
            "recent_ms": self.recent,
            **self.points(),
            **self.summary(),
        }

    def _guard(self, step: Callable[[], None], after: Iterable[Callable[[], Any]]) -> None:
        """Runs a thread; its failure ends the others, and each ends those that wait for it."""
        try:
            step()
        except BaseException as error:
            if self._failure is None:
                self._failure = error
            self._stop.set()
        finally:
            for close in after:
                close()

    # Main thread: the log, and whether the source still gives frames.

    def _watch(self) -> None:
        said, processed, stalled = time.perf_counter(), 0, False
        while not self._finished.wait(0.05) and not self._stop.is_set():
            now = time.perf_counter()
            since = self._waiting_since
            silent = now - since if since is not None else 0.0
            if silent > _STALL_WARNING and not stalled:
                self.stalls += 1
                log.warning("%s: no frame for %.0f s", self.source_name, silent)
                self._sink.event("stall", self.settings.first + self.frames_in)
            stalled = silent > _STALL_WARNING
            if silent > self.settings.give_up:
                trouble = f" (last error: {self._last_trouble})" if self._last_trouble else ""
                self._failure = self._failure or PlayerError(
                    f"{self.source_name}: no frame for {silent:.0f} s{trouble}; check the camera and its cable, or "
                    "give more time with --give-up"
                )
                self._stop.set()
            if now - said >= 1:
                recent, self._recent = self._recent, Latencies()
                self.recent = recent.summary()
                self.rate = (self.processed - processed) / (now - said)
                said, processed = now, self.processed
                log.info("%s", self._line(self.recent))

    def _line(self, latency: Mapping[str, float | None]) -> str:
        times = ", ".join(f"{name} {value}" for name, value in latency.items())
        return (
            f"{self.rate:.1f} frames/s; in {self.frames_in}, processed {self.processed}, dropped {self.dropped}, "
            f"overruns {self.overruns}; latency ms: {times}; points {self.tracked} of {self._stepper.found}"
        )

    # Capture: source -> frames.

    def _capture(self) -> None:
        source: Source | None = self._source
        attempt, start = 0, math.nan
        try:
            while not self._stop.is_set() and self.frames_in != self.settings.frames:
                self._waiting_since = self._waiting_since or time.perf_counter()
                try:
                    source = source or self._open_source(self.settings.first + self.frames_in)
                    frame = source.read()
                except PlayerError:
                    raise
                except Exception as error:
                    self._lost(source, error, attempt)
                    source, attempt = None, attempt + 1
                    continue
                self._waiting_since, attempt = None, 0
                if frame is None:
                    break
                arrival = time.perf_counter()
                if self.settings.rate is not None and not source.live:
                    start = arrival if math.isnan(start) else start
                    # A camera of that rate gives the frame at this time: being late after it counts as latency.
                    arrival = start + self.frames_in / self.settings.rate
                    if (wait := arrival - time.perf_counter()) > 0:
                        time.sleep(wait) if wait < 0.1 else self._stop.wait(wait)
                self._take(frame, arrival, source.live or self.settings.rate is not None)
        finally:
            self._waiting_since = None
            if source is not None:
                close_within(_HANGING, source)

    def _lost(self, source: Source | None, error: Exception, attempt: int) -> None:
        """After an error of the source: it is closed and opened again, later and later."""
        self._last_trouble = f"{type(error).__name__}: {first_line(error)}"
        self.reconnects += 1
        delay = min(0.1 * 2**attempt, 5.0)
        log.warning("%s: %s; trying again in %.1f s", self.source_name, self._last_trouble, delay)
        self._sink.event("reconnect", self.settings.first + self.frames_in, error=self._last_trouble)
        if source is not None:
            close_within(_HANGING, source)
        self._stop.wait(delay)

    def _take(self, frame: Array, arrival: float, cannot_wait: bool) -> None:
        slot = self._free.get(wait=False)
        if slot is None:
            self.overruns += cannot_wait
            slot = self._free.get()
        if slot is None:  # the stream has failed
            return
        slot.number, slot.arrival = self.settings.first + self.frames_in, arrival
        slot.fill(frame, self.scene, self.bundle, self.source_name)
        slot.blocks, slot.status = self._check.look(slot.views)
        self.frames_in += 1
        if self.settings.every:
            self._frames.put(slot)
        elif (overtaken := self._frames.put_newest(slot)) is not None:
            self.dropped += 1
            self._free.put(overtaken)

    # Compute: frames -> records, in as many threads as frames are computed side by side.

    def _compute(self) -> None:
        try:
            while (begun := self._begin()) is not None:
                number, (slot, side) = begun
                self._stepper.run(side)
                self._order.done(number, (slot, side))
                # Not while frames are ended: others would wait.
                any(one.work.prepare_piece(self._stepper.prepared) for one in tuple(self._renewals))
            with self._beginning:  # by the first of these threads that gets here
                if self._order.wait_for_all():
                    self._settle(None)
        except BaseException:
            self._order.stop()
            raise

    def _begin(self) -> tuple[int, tuple[Slot, int]] | None:
        """The next frame; None where there is none or the stream has failed."""
        with self._beginning:
            if not self._order.wait_for_room():
                return None
            slot = self._frames.get()
            if slot is None or not self._prepare(slot, self._order.begun):
                return None
            measure = self._stepper.measures and self._search.wants(self._order.begun)
            side = self._stepper.begin(slot, measure)
            return self._order.begin(), (slot, side)

    def _close_records(self) -> None:
        """After the last of these threads no record comes."""
        with self._beginning:
            self._computing -= 1
            if not self._computing:
                self._records.close()

    def _prepare(self, slot: Slot, index: int) -> bool:
        """What changes before a frame begins; False where the stream has failed."""
        change, threshold = self._change, self._search.due(index)
        if index == 0:
            self._first = slot.arrival
        starting = not self.restarts and slot.status == USABLE
        if change is not None and index < change.after + self._stepper.lag:
            change = None
        due = self._renewals and index >= self._renewals[0].due
        if change is None and threshold is None and not due and not starting:
            return True
        templates = self._renewals[0].work.templates(self._stepper.prepared) if due else {}
        if not self._order.wait_for_all():  # they read what changes now
            return False
        self._settle(slot)
        if starting:
            self._restart(index, slot, self._stepper.choose(slot), "start")
        if threshold is not None:
            self._stepper.use(threshold)
            self._search.used()
        if due and (renewing := self._renewals.popleft()).key == self.restarts + self.keys:
            self._stepper.renew(renewing.work.rows, templates)
        if change is not None:
            if change.cause == REKEY:
                self._rekey(change.key, change.points)
            else:
                self._choose(index, change)
            self._change = None
            self._free.put(change.key)
        return True

    def _choose(self, index: int, change: Change) -> None:
        """Takes new points where they are more than those that are followed."""
        points = self._stepper.choose(change.key)
        if count_known(points) > (0 if change.cause == _PAGE else count_known(change.points)):
            self._slip.follow_others(change.points[0], points[0])
            self._restart(index, change.key, points, change.cause)
        else:
            self._upkeep.kept(index)

    def _restart(self, index: int, slot: Slot, points: Array, cause: str) -> None:
        self._stepper.restart(slot, points)
        self._upkeep.restarted(index, slot.number, self._stepper.found)
        self._search.begin()
        self.restarts += 1
        self._sink.event("restart", slot.number, cause=cause, points=self._stepper.found)
        log.info("frame %d: %d points chosen (%s)", slot.number, self._stepper.found, cause)

    def _rekey(self, slot: Slot, points: Array) -> None:
        self._stepper.key(slot, points)
        self._upkeep.keyed(slot.number, self._stepper.keyed)
        self.keys += 1
        self._sink.event("key_frame", slot.number, points=self._stepper.keyed)

    def _end(self, computed: tuple[Slot, int]) -> bool:
        """Hands a record on and decides whether something is to change; False where the stream has failed."""
        slot, side = computed
        if not self._settle(slot):
            return False
        index = self.processed
        elsewhere = slot.status == USABLE and self._stepper.look_again(slot, side).elsewhere
        found = self._stepper.found_in(side)
        status = self._check.see(slot.number, slot.blocks, slot.status, found, elsewhere)
        self._unlooked += 1
        if status is None:
            self._in_doubt = slot, side
            self._stepper.skip(side)
            return True
        if status != USABLE:
            return self._skip(slot, side, status)
        place, outputs = self._finish(slot, side)
        if self._stepper.measures:
            area = float(outputs["real_area_px"][0])
            self._learn_threshold(slot, index, area, self._stepper.measured(side))
        if self._unlooked >= self._pace.frames:
            self._unlooked = 0
            self._look_at_templates(index, outputs)
        drawn = None
        if self._change is None and (cause := self._cause_to_change(slot, index)):
            self._change = Change(index, slot, outputs["points"].copy(), cause)
        elif not self._drawing and self.live.is_due():
            self._drawing = True
            real_contact_mask = outputs.get("real_contact_mask")
            drawn = LiveViews(slot, None if real_contact_mask is None else real_contact_mask.copy())
        else:
            self._free.put(slot)
        return self._records.put((place, drawn))

    def _finish(self, slot: Slot, side: int, late: bool = False) -> tuple[int, dict[str, Array]]:
        """Fills the record of a frame that counts; its place, and what the graphs gave."""
        place = self.processed % len(self._room)
        outputs = self._stepper.finish(side, late)
        self.tracked = self._stepper.found_in(side)
        self._layout.fill(self._fields, place, outputs)
        self._fill(slot, place, USABLE)
        self._fill_slip(outputs, place)
        self._findings.count(self.tracked, float(outputs["real_area_px"][0]))
        return place, outputs

    def _settle(self, following: Slot | None) -> bool:
        """The record of a frame that was in doubt, as the one behind it is known; False where the stream has failed.

        Nothing else is learnt from it: frames behind it may have begun, and what they are given is not to depend on how
        far they have got.
        """
        if self._in_doubt is None:
            return True
        (slot, side), self._in_doubt = self._in_doubt, None
        status = self._check.settle(None if following is None or following.status != USABLE else following.blocks)
        if status != USABLE:
            return self._skip(slot, side, status)
        if self._stepper.measured(side) is not None:
            self._search.passed_over()
        place, _ = self._finish(slot, side, late=True)
        self._free.put(slot)
        return self._records.put((place, None))

    def _skip(self, slot: Slot, side: int, status: int) -> bool:
        """A frame that is no picture of the trial: its numbers are NaN, and nothing is learnt from it."""
        place = self.processed % len(self._room)
        self._stepper.skip(side)
        if self._stepper.measured(side) is not None:
            self._search.passed_over()
        if self._findings.skip(status):
            self._sink.event("not_usable", slot.number, status=FRAME_STATUS[status])
            log.warning("frame %d: %s, counts in no result", slot.number, FRAME_STATUS[status])
        self._layout.fill_unknown(self._fields, place)
        self._fill(slot, place, status)
        if self._layout.tells_slip:
            self._fields["slip_residual"][place] = math.nan
            self._fields["slip_flag"][place] = self._slip.slipping
        self._free.put(slot)
        return self._records.put((place, None))

    def _look_at_templates(self, index: int, outputs: dict[str, Array]) -> None:
        """Those that are to be renewed count after as many frames again; where skin is fast, as soon as may be."""
        key = self.restarts + self.keys
        self._pace.see(key, index, outputs["warp"])
        later = MOST_FRAMES if self._pace.frames == MOST_FRAMES else self._stepper.lag
        under_way = [one.work.rows for one in self._renewals if one.key == key]  # those that are due are gone
        work = self._stepper.stale(outputs, np.concatenate([np.empty(0, int), *under_way]))
        if work is not None:
            self._renewals.append(Renewing(index + 1 + later, key, work))

    def _cause_to_change(self, slot: Slot, index: int) -> str:
        """Why points are to be chosen anew, or kept and compared with this frame; empty for neither."""
        if self.restart_wanted.is_set():
            self.restart_wanted.clear()
            return _PAGE
        return self._upkeep.see(index, slot.number, self.tracked)

    def _learn_threshold(self, slot: Slot, index: int, area: float, measured: float | None) -> None:
        if self._search.see(index, area, measured) and measured is not None:
            self._sink.event("threshold", slot.number, threshold=measured)
            log.info("frame %d: threshold %.4f of the intensity lost", slot.number, measured)

    def _fill(self, slot: Slot, place: int, status: int) -> None:
        latency = time.perf_counter() - slot.arrival
        for name, value in (
            *(("frame", slot.number), ("time", slot.arrival - self._first), ("latency", latency)),
            *(("key_frame", self._upkeep.key_frame), ("restart", self.restarts), ("frame_status", status)),
            ("contact_threshold", self._stepper.threshold if status == USABLE else math.nan),
        ):
            self._fields[name][place] = value
        self.latencies.add(latency)
        self._recent.add(latency)
        self.processed += 1

    def _fill_slip(self, outputs: dict[str, Array], place: int) -> None:
        if self._layout.tells_slip:
            points, std, covered = (outputs[name][0] for name in ("points", "position_std", "covered"))
            slip = self._slip.see(points, std, covered)
            self._fields["slip_residual"][place] = slip.residual * self._topography_mm_per_px
            self._fields["slip_flag"][place] = slip.slipping

    # Sink: records -> disk and page.

    def _store(self) -> None:
        as_bytes = self._room.view(np.uint8).reshape(len(self._room), -1)
        traced = -math.inf
        while (item := self._records.get()) is not None:
            place, views = item
            record = self._room[place]
            if views is not None:
                self.live.show(record, views)
                self._free.put(views.slot)
                self._drawing = False
            if record["time"] - traced >= _TRACE_INTERVAL:
                traced = float(record["time"])
                self.live.trace(record)
            self._sink.write(as_bytes[place], int(record["frame"]))
            if self._records.is_empty():  # to be woken for several records instead of for each
                time.sleep(_STORE_INTERVAL)
