"""Stream player: the threads of a stream, and the transfer of frames, outcomes and records between threads."""

import math
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fingerflow.engines.bundle import Bundle
from fingerflow.engines.engine import Array
from fingerflow.errors import FingerflowError, PlayerError, first_line
from fingerflow.player.camera_clock import EPOCH, CameraClock
from fingerflow.player.findings import Findings
from fingerflow.player.handover import Channel, Slot
from fingerflow.player.keeping_up import KeepingUp
from fingerflow.player.latency import Latencies
from fingerflow.player.live_data import LiveData
from fingerflow.player.live_forces import FrameForces
from fingerflow.player.live_values import LiveValues
from fingerflow.player.logged_warnings import log, logged_warnings
from fingerflow.player.outputs.output import FrameStamp
from fingerflow.player.page_server import serve_page
from fingerflow.player.played import StreamInput
from fingerflow.player.records import RecordLayout
from fingerflow.player.sending import Destination, Sender
from fingerflow.player.sources.source import Source, close_within
from fingerflow.results.stream_folder import Sink
from fingerflow.schema.variables import FRAME_STATUS, USABLE
from fingerflow.tracker.area_steps import check_cut, cut_shares
from fingerflow.tracker.frame_distances import LONGEST
from fingerflow.tracker.frame_tracker import Event, FrameOutcome, StreamTracker
from fingerflow.tracker.reseeding import ThresholdSearch

_STALL_WARNING = 2.0  # s without a frame after which a warning is logged
_HANGING = 2.0  # s for which a stopped stream waits for its source before it abandons the source
_TRACE_INTERVAL = 1 / 30  # s between points of the traces on the live page
_WATCH_INTERVAL = 0.2  # s between two checks by the main thread
_VIBRATION_INTERVAL = 5.0  # s between two searches for a vibration, for which frames wait some ms
_STORE_INTERVAL = 0.02  # s between two wake-ups of the storing thread
_COUNTS = ("frames_in", "processed", "dropped", "overruns", "reconnects", "stalls")  # of the summary
_SENTENCES = {  # log messages by the names of the tracker's events
    "restart": "{points} points seeded ({cause})",
    "key_frame": "{points} points followed from a new key frame",
    "threshold": "threshold {threshold:.4f} of the intensity lost",
}
_AT_ONCE = 4  # largest number of frames that are measured at once
_RECORDS_WAITING = 512  # number of queued records, of more than a second: the time that a slow disk may take to sync


@dataclass(frozen=True)
class Settings:
    """Settings of one run of the player: which frames are processed and at what rate, when the stream ends,
    and where the live page is served.

    Attributes:
        process_all: process every frame, so that the source waits for space; else the newest, dropping older ones.
        queue: largest number of waiting frames; 1 with the policy `latest`.
        rate: Hz at which a recording is played, None for as fast as possible.
        frames: number of frames after which the stream ends, None for the source's end.
        give_up: s without a frame after which the stream ends with an error.
        page: host and port of the live page, None for none; port 0 takes a free one.
    """

    process_all: bool = True
    queue: int = 32
    rate: float | None = None
    frames: int | None = None
    give_up: float = 30.0
    page: tuple[str, int] | None = None


class Player:
    """Player of one stream, from the frame source to stored results; `run` returns when the stream has ended.

    Raises FingerflowError for every error that the user can correct; the results until then are complete.
    """

    def __init__(
        self,
        tracker: StreamTracker,
        computed_by: str,
        bundle: Bundle,
        played: StreamInput,
        source: Source,
        sink: Sink,
        layout: RecordLayout,
        settings: Settings,
        forces: FrameForces | None,
        values: LiveValues,
        destinations: Sequence[Destination],
    ) -> None:
        self.bundle, self.scene, self.settings = bundle, played.scene, settings
        self.computed_by, self.source_name = computed_by, played.name
        self._tracker, self._sink, self._layout = tracker, sink, layout
        self._source, self._open_source, self._first_number = source, played.open_source, played.first
        # Slots in use: one is being filled, one is computed, up to LONGEST are deferred, up to EVERY - 1 wait for a
        # threshold, up to _AT_ONCE are measured, one is drawn on the page. The others form the queue.
        count = settings.queue + 2 + LONGEST + ThresholdSearch.EVERY + _AT_ONCE
        slots = [Slot(bundle, played.scene) for _ in range(count)]
        # Take the slot that was used last, which is still in the processor's cache.
        self._free = Channel(len(slots), slots, newest_first=True)
        self._frames: Channel[Slot] = Channel(len(slots) if settings.process_all else 1)
        self._outcomes: Channel[Event | FrameOutcome] = Channel(len(slots))
        self._calls: Channel[bool] = Channel(1)  # for the measuring thread
        self._measuring = threading.Lock()  # held by the thread that measures
        self._unfinished = False  # True while a thread measures, and for good once an exception has ended that
        self._records: Channel[tuple[int, Slot | None, Array | None]] = Channel(_RECORDS_WAITING)
        # Two more records than are queued: one is being filled, one written.
        self._room = np.zeros(_RECORDS_WAITING + 2, layout.dtype)
        # Views of the fields, looked up only once.
        self._fields = {name: self._room[name] for name in self._room.dtype.names or ()}
        self.frames_in = self.processed = self.dropped = self.overruns = self.reconnects = self.stalls = 0
        self.tracked = 0
        self.latencies, self._recent = Latencies(), Latencies()
        self._busy: dict[str, float] = {}  # processor time of each thread that has ended, s
        self.recent = self.latencies.summary()
        self.rate = self._first = math.nan
        self._forces, self._values = forces, values
        # True if the source can wait for results, as a file played as fast as possible can.
        self._can_wait = settings.process_all and settings.rate is None and not source.live
        # True if the computing thread measures, too, unless behind.
        self._alone = settings.process_all and not self._can_wait
        self._senders = [Sender(destination, self._can_wait, self._record_trigger) for destination in destinations]
        self.live = LiveData(bundle, played.expected, forces.names if forces else ())
        self._state, self._said = "waiting", ""  # state and message shown on the page
        self._behind = ""  # message shown on the page: how results fall behind the camera
        self._keeping_up = KeepingUp(LONGEST + 1)
        # Number and time of the newest frame, and of the frame of the newest result; None before there is a frame.
        self._newest: tuple[int, float] | None = None
        self._measured: tuple[int, float] | None = None
        self._clock, self._size = CameraClock(), played.size
        self._stop, self._finished = threading.Event(), threading.Event()
        self._failure: BaseException | None = None
        self._waiting_since: float | None = None  # time since which the source has been waited for
        self._findings = Findings()
        self._drawing = False  # True while a frame is queued for the page
        self._last_trouble = ""
        self._logged = set[str]()  # faults that were logged

    def run(self) -> dict[str, Any]:
        """Process the stream until it ends or is stopped, and return its summary: frame counts, frame rate, latencies
        and warnings.
        """
        with logged_warnings() as self._warnings:
            return self._run()

    def _run(self) -> dict[str, Any]:
        after_computing = (self._free.close, self._frames.close, self._outcomes.close, self._calls.close)
        threads = [
            threading.Thread(target=self._run_guarded, args=(step, after), name=step.__name__.strip("_"), daemon=True)
            for step, after in (
                (self._capture, (self._frames.close,)),
                (self._compute, after_computing),
                (self._measure, (*after_computing, self._records.close)),
                (self._store, (self._records.close, self._finished.set)),
            )
        ]
        self._started = time.perf_counter()
        address = self.settings.page
        page = None
        try:
            page = serve_page(address, self.live, self._said_by_page, self._tracker.reseed) if address else None
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
            self._close_senders()
            if threads[0].ident is None:
                close_within(_HANGING, self._source)
            try:
                self._sink.close()
            except FingerflowError as error:
                self._failure = self._failure or error
            if self._failure is None and sys.exc_info()[1] is None:
                self._log_findings()
            summary = self.summary() | {"warnings": self._warnings}
            if self.processed:
                self._sink.write_summary(summary)
            else:
                self._sink.discard()
            if page:
                failure = self._failure or sys.exc_info()[1]
                self._state, self._said = "failed" if failure else "ended", first_line(failure) if failure else ""
                page.stop()
        if self._failure is not None:
            raise self._failure
        return summary

    def _log_findings(self) -> None:
        self._log_faults()
        few, missing = self._findings.unknown_medians(), self._findings.missing(math.isfinite(self._tracker.threshold))
        for sentence in missing:
            log.warning("%s", sentence)
        if few and not any(few in sentence for sentence in missing):
            log.info("%s", few)

    def _log_faults(self) -> None:
        """Log each fault of the recording once: a faint rim, a contact cut off by the view, a frozen view, steps of the
        area, and vibration.
        """
        slides, mm_per_px = self.scene.kind == "slip", self._tracker.geometry.topography_mm_per_px
        view_mm2 = self.bundle.height * self.bundle.width * self.scene.calibration.mm_per_px**2
        for fault, sentences in {
            "faint": self._tracker.check_faint_rim(),
            "cut": check_cut(*self._findings.cut),
            "stale": self._tracker.check.stale_views.warnings(),
            "steps": self._findings.area_steps(view_mm2, slides),
            "vibrates": self._tracker.results.entries.check_vibration(mm_per_px),
        }.items():
            for sentence in () if fault in self._logged else sentences:
                self._logged.add(fault)
                log.warning("%s", sentence)

    def stop(self) -> None:
        """End the stream cleanly: frames that have already arrived are still processed."""
        self._stop.set()
        for sender in self._senders:
            sender.stop_waiting()

    def summary(self) -> dict[str, Any]:
        """Return the frame counts, duration in s, frame rate and latencies of the stream so far."""
        seconds = getattr(self, "_seconds", time.perf_counter() - self._started)
        return {
            **{name: getattr(self, name) for name in _COUNTS},
            "restarts": self._tracker.restarts,
            "key_frames": self._tracker.keys,
            "not_usable": dict(self._findings.not_usable),
            "seconds": round(seconds, 3),
            "rate_hz": round(self.processed / seconds, 2),
            "latency_ms": self.latencies.summary(),
            "first_frame": None if not self._first > 0 else EPOCH + self._first,
            "time_stamps": "camera" if self._clock.has_stamps else "arrival" if self._first else "recording",
            "outputs": [sender.facts() for sender in self._senders],
            "threshold": self._tracker.threshold if math.isfinite(self._tracker.threshold) else None,
            "results": str(self._sink.folder) if self.processed else None,
            "engine": self.computed_by,
            "busy": {name: round(busy / seconds, 3) for name, busy in self._busy.items()},
            "policy": "every" if self.settings.process_all else "latest",
        }

    def _said_by_page(self) -> dict[str, Any]:
        return {
            "bundle": self.bundle.folder.resolve().name,
            "computed_by": self.computed_by,
            "mm_per_px": self.scene.calibration.mm_per_px,
            "topography_mm_per_px": self._tracker.geometry.topography_mm_per_px,
            "state": "running" if self._state == "waiting" and self.processed else self._state,
            "said": self._said,
            "fields": list(self._fields),
            "source": self.source_name,
            "behind": self._behind,
            "rate": None if math.isnan(self.rate) else self.rate,
            "recent_ms": self.recent,
            "tracked": self.tracked,
            "found": self._tracker.seeded,
            **self.summary(),
        }

    def _run_guarded(self, step: Callable[[], None], after: Iterable[Callable[[], Any]]) -> None:
        """Run `step`, the work of one thread, then call each function of `after`, which closes a queue; an exception of
        `step` stops the stream.
        """
        try:
            step()
        except BaseException as error:
            self._failure = self._failure or error
            self._stop.set()
        finally:
            self._busy[step.__name__.strip("_")] = time.thread_time()
            for close in after:
                close()

    def _close_senders(self) -> None:
        """Close all outputs and the force sensor, and log what was sent."""
        for sender in self._senders:
            sender.close()
            (log.warning if sender.lost else log.info)("%s", sender.describe())
        if self._forces is not None:
            self._forces.close()

    def _record_trigger(self, frame: int, condition: str, latency: float) -> None:
        self._sink.event("trigger", frame, condition=condition, latency_ms=round(1e3 * latency, 3))

    # Main thread: write the log and monitor the source.

    def _watch(self) -> None:
        logged = checked = time.perf_counter()
        processed, stalled = 0, False
        while not self._finished.wait(_WATCH_INTERVAL) and not self._stop.is_set():
            now = time.perf_counter()
            silent = now - (self._waiting_since or now)
            if silent > _STALL_WARNING and not stalled:
                self.stalls += 1
                log.warning("%s: no frame for %.0f s", self.source_name, silent)
                self._sink.event("stall", self._first_number + self.frames_in)
            stalled = silent > _STALL_WARNING
            if silent > self.settings.give_up:
                trouble = f" (last error: {self._last_trouble})" if self._last_trouble else ""
                self._failure = self._failure or PlayerError(
                    f"{self.source_name}: no frame for {silent:.0f} s{trouble}; check the camera and its cable, or "
                    "give more time with --give-up"
                )
                self._stop.set()
            if now - logged >= 1:
                recent, self._recent = self._recent, Latencies()
                self.recent = recent.summary()
                self.rate = (self.processed - processed) / (now - logged)
                logged, processed = now, self.processed
                log.info("%s", self._line(self.recent))
            if now - checked >= _VIBRATION_INTERVAL:
                checked = now
                self._log_faults()
            self._behind = self._falls_behind(now)

    def _falls_behind(self, now: float) -> str:
        """Return in a few words how results fall behind the camera at a time in s, "" if they keep up or if the source
        waits for them.
        """
        newest, measured = self._newest, self._measured
        if self._can_wait or newest is None or measured is None:
            return ""
        # While the source is waited for, no frame is late that has not come.
        age = (now if self._waiting_since is None else newest[1]) - measured[1]
        lost = self.dropped + self.overruns, sum(sender.lost for sender in self._senders)
        # Results wait for the first threshold, of a slow camera for seconds.
        median = None if math.isnan(self._tracker.threshold) else self.recent["median"]
        return self._keeping_up.describe(now, age, newest[0] - measured[0], lost, median)

    def _line(self, latency: Mapping[str, float | None]) -> str:
        times = ", ".join(f"{name} {value}" for name, value in latency.items())
        return (
            f"{self.rate:.1f} frames/s; in {self.frames_in}, processed {self.processed}, dropped {self.dropped}, "
            f"overruns {self.overruns}; latency ms: {times}; points {self.tracked} of {self._tracker.seeded}"
        )

    # Capturing thread: from the source to frames.

    def _capture(self) -> None:
        source: Source | None = self._source
        attempt = 0
        start = math.nan
        try:
            while not self._stop.is_set() and self.frames_in != self.settings.frames:
                self._waiting_since = self._waiting_since or time.perf_counter()
                try:
                    source = source or self._open_source(self._first_number + self.frames_in)
                    frame = source.read()
                except FingerflowError:
                    raise
                except Exception as error:
                    self._close_failed(source, error, attempt)
                    source, attempt = None, attempt + 1
                    continue
                except BaseException as error:
                    problem = f"its module ended the stream by {type(error).__name__}; return None after the last frame"
                    raise PlayerError(f"{self.source_name}: {problem}") from error
                self._waiting_since, attempt = None, 0
                if frame is None:
                    break
                exposed = arrival = time.perf_counter()
                if source.live:
                    exposed, arrival = self._clock.update(source.stamp, arrival)
                elif (seconds := self._recorded_time(source.stamp)) is not None:
                    exposed, self._first = seconds, 0.0
                if self.settings.rate is not None and not source.live:
                    start = arrival if math.isnan(start) else start
                    # A camera at this rate would deliver the frame at this time, so any later delay counts as latency.
                    arrival = start + self.frames_in / self.settings.rate
                    if (wait := arrival - time.perf_counter()) > 0:
                        time.sleep(wait) if wait < 0.1 else self._stop.wait(wait)
                self._take(frame, (exposed, arrival), source.live or self.settings.rate is not None)
        finally:
            self._waiting_since = None
            if source is not None:
                close_within(_HANGING, source)

    def _recorded_time(self, stamp: float) -> float | None:
        """Return the time of the next frame of a recording, s, by the frame rate of the scene, by the time in the file,
        `stamp`, or by the rate at which it is played; None, with a warning, if there is none of these.
        """
        recording, unstamped = self.scene.recording, math.isnan(stamp)
        rate = recording.frame_rate or self.settings.rate
        if rate and (recording.frame_rate or unstamped):
            return (self._first_number + self.frames_in - (recording.trigger_frame or 0)) / rate
        if unstamped and not self.frames_in and self.source_name != "synthetic":
            log.warning("%s: `time` is that of arrivals here; state recording.frame_rate or --rate", self.source_name)
        return None if unstamped else stamp

    def _close_failed(self, source: Source | None, error: Exception, attempt: int) -> None:
        """Log the error of a frame source, close it, and wait before it is reopened, longer at each attempt."""
        self._last_trouble = f"{type(error).__name__}: {first_line(error)}"
        self.reconnects += 1
        delay = min(0.1 * 2**attempt, 5.0)
        self._clock = CameraClock()  # the stamps of a reopened camera may start from 0 again
        log.warning("%s: %s; trying again in %.1f s", self.source_name, self._last_trouble, delay)
        self._sink.event("reconnect", self._first_number + self.frames_in, error=self._last_trouble)
        if source is not None:
            close_within(_HANGING, source)
        self._stop.wait(delay)

    def _take(self, frame: Array, times: tuple[float, float], cannot_wait: bool) -> None:
        slot = self._free.get(wait=False)
        if slot is None:
            self.overruns += cannot_wait
            slot = self._free.get()
        if slot is None:  # the stream has failed, and its queues are closed
            return
        slot.number = self._first_number + self.frames_in
        slot.time, slot.arrival = times
        self._size = self._size or frame.shape
        if frame.ndim == 2 and frame.shape != self._size:  # `fill` refuses colours
            raise PlayerError(
                f"{self.source_name}: frame {slot.number} is {frame.shape}, the background or the frames before are "
                f"{self._size}: the views lie elsewhere in it; keep size, binning and region of the camera as they are"
            )
        slot.fill(frame, self.bundle, self.source_name)
        self._tracker.inspect(slot)
        self.frames_in += 1
        self._newest = slot.number, slot.arrival
        self._measured = self._measured or self._newest
        if self.settings.process_all:
            self._frames.put(slot)
        elif (overtaken := self._frames.put_newest(slot)) is not None:
            self.dropped += 1
            self._free.put(overtaken)

    # Computing thread: from frames to outcomes.

    def _compute(self) -> None:
        slot: Slot | None
        while (slot := self._frames.get()) is not None:
            if math.isnan(self._first):
                self._first = slot.time
            for outcome in self._tracker.step(slot):
                if not self._outcomes.put(outcome):  # the stream has failed
                    return
            # Threads that run Python wait for each other: a second one pays only where several frames wait.
            if not self._alone or len(self._frames) > 1 or self._measuring.locked():
                self._calls.put_newest(True)
            else:
                self._measure_unless_failed()
        for outcome in self._tracker.settle():
            self._outcomes.put(outcome)

    # Measuring thread, or the computing one: from outcomes to records.

    def _measure(self) -> None:
        while self._calls.get():
            self._measure_unless_failed()
        self._measure_unless_failed()

    def _measure_unless_failed(self) -> None:
        """Measure the tracked frames, unless an exception has ended this in either thread: a later frame's record would
        be out of order.
        """
        with self._measuring:
            if not self._unfinished:
                self._unfinished = True
                self._measure_outcomes()
                self._unfinished = False

    def _measure_outcomes(self) -> None:
        """Measure the tracked frames and pass on their records, `_AT_ONCE` at a time while others wait."""
        item: Event | FrameOutcome | None = None
        while item is not None or len(self._outcomes) >= self._least():
            item, following = item or self._outcomes.get(), None
            if isinstance(item, Event):
                self._sink.event(item.name, item.frame, **item.facts)
                log.info("frame %d: %s", item.frame, _SENTENCES[item.name].format(**item.facts))
            elif item is not None:
                frames = [item]
                try:
                    following = self._add_frames(frames)
                    results = None if item.points is None else self._tracker.compute_results(frames)
                except Exception:  # an engine may raise anything; the frames before the one at fault are good
                    while self._outcomes.get(False) is not None:  # later frames, whose results would lack these
                        pass
                    for frame in frames:  # one at a time, to keep those before the fault
                        self._pass_record(frame, self._tracker.compute_results([frame]), 0)
                    raise
                if not all(self._pass_record(frame, results, k) for k, frame in enumerate(frames)):
                    return
            item = following

    def _least(self) -> int:
        """Return how many tracked frames are measured at least: `_AT_ONCE` while others wait for tracking, else 1."""
        return _AT_ONCE if self._alone and self._frames and not self._failure else 1

    def _add_frames(self, frames: list[FrameOutcome]) -> Event | FrameOutcome | None:
        """Add frames that can be measured in one call with the first of `frames`, up to `_AT_ONCE`; return the next
        item of the queue, None if it has not come yet.

        One call takes less time than a call for each frame. A source that can wait always waits for more frames.
        """
        while len(frames) < _AT_ONCE and frames[0].points is not None:
            self._tracker.contact(frames[-1])  # while others are tracked
            item = self._outcomes.get(self._can_wait)
            if not isinstance(item, FrameOutcome) or item.points is None or item.seeding is not frames[0].seeding:
                return item
            frames.append(item)
        return None

    def _pass_record(self, outcome: FrameOutcome, results: Mapping[str, Array] | None, k: int) -> bool:
        """Offer the results of a frame, the k-th of `results` and None without any, to the outputs, and queue a record
        of them to be stored; return False if the stream has failed.
        """
        slot, index, fields = outcome.frame, self.processed % len(self._room), self._fields
        assert isinstance(slot, Slot)
        self.tracked = outcome.tracked
        if results is None:
            if outcome.status != USABLE and self._findings.skip(outcome.status):
                self._sink.event("not_usable", slot.number, status=FRAME_STATUS[outcome.status])
                log.warning("frame %d: %s, counts in no result", slot.number, FRAME_STATUS[outcome.status])
            self._layout.fill_unknown(fields, index)
            fields["slip_flag"][index] = self._tracker.results.slip.slipping
        else:
            self._layout.fill(fields, index, results, k)
            counted = [results[name][k] for name in ("real_contact_area", "gross_contact_area", "median_divergence")]
            counted += [*cut_shares(self._tracker.contact(outcome).density_margin[:, 0], counted[1])]
            self._findings.count(slot.number, outcome.tracked, *map(float, counted))
        if self._forces is not None:
            for name, force in self._forces.read(slot.number, slot.arrival).items():
                fields[name][index] = force
        latency = time.perf_counter() - slot.arrival
        fields["frame"][index], fields["time"][index] = slot.number, slot.time - self._first
        fields["latency"][index], fields["frame_status"][index] = latency, outcome.status
        fields["key_frame"][index], fields["restart"][index] = outcome.key_frame, outcome.restart
        fields["contact_threshold"][index] = outcome.threshold
        if self._senders:
            record = self._room[index].copy()
            message = FrameStamp(slot.number, EPOCH + slot.arrival, math.nan, record), self._values.flatten(record)
            for sender in self._senders:
                sender.offer(message)
        self.latencies.add(latency)
        self._recent.add(latency)
        self.processed += 1
        self._measured = slot.number, slot.arrival
        if results is None or self._drawing or not self.live.is_due():
            self._free.put(slot)
            return self._records.put((index, None, None))
        self._drawing = True
        mask = None if outcome.contact is None else outcome.contact.real_contact_mask
        return self._records.put((index, slot, None if mask is None else mask[0, 0].copy()))

    # Storing thread: from records to the disk and the page.

    def _store(self) -> None:
        as_bytes = self._room.view(np.uint8).reshape(len(self._room), -1)
        traced = -math.inf
        while (item := self._records.get()) is not None:
            index, slot, mask = item
            record = self._room[index]
            if slot is not None:
                self.live.show(record, slot, mask)
                self._free.put(slot)
                self._drawing = False
            if record["time"] - traced >= _TRACE_INTERVAL:
                traced = float(record["time"])
                self.live.trace(record)
            self._sink.write(as_bytes[index], int(record["frame"]))
            if not self._records:  # wait, so that one wake-up serves several records
                time.sleep(_STORE_INTERVAL)
