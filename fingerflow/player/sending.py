"""Sending of live values: one thread per output, so that a slow output delays neither the stream nor other outputs."""

import contextlib
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

from fingerflow.errors import FingerflowError, first_line
from fingerflow.player.camera_clock import unix_now
from fingerflow.player.condition import Condition
from fingerflow.player.handover import Channel
from fingerflow.player.latency import Latencies
from fingerflow.player.logged_warnings import log
from fingerflow.player.outputs.output import LiveFrame, Output

_WAITING = 256  # largest number of queued messages
_CATCH_UP = 0.01  # s within which all queued messages must be sent; if it takes longer, only the newest is sent
_CLOSING = 2.0  # s for which a stopped stream waits for an output before it abandons the output


class Destination(NamedTuple):
    """Opened output, the names of the live values that it is sent, and the condition on which it is sent them.

    Attributes:
        name: for messages.
        values: names of the values that it is sent.
        condition: on which it is sent a frame; None for every frame.
    """

    name: str
    output: Output
    values: tuple[str, ...]
    condition: Condition | None = None


Triggered = Callable[[int, str, float], None]  # called with the frame's number, the condition, the latency in s


class Sender:
    """Thread that sends the live values of frames to one output.

    Of the frames that come while the output is busy the newest is sent next, and the overtaken ones are counted. All of
    them are sent where that takes 10 ms at most, by the time of the last message: then not the output was slow, but
    this thread had to wait for a processor. With a condition only the frames at which it becomes true are sent, in
    turn; up to 256 wait.

    Args:
        to: where to send.
        waits: whether the stream waits for the output instead of overtaking frames, as it may for a file.
        triggered: called after each message of a condition.

    Attributes:
        sent, failed: counts of messages. What was not sent when the stream ended has failed.
        latencies: from the camera time of a frame to the end of its sending.
    """

    def __init__(self, to: Destination, waits: bool = False, triggered: Triggered | None = None) -> None:
        self.name, self._output, self._values, self._condition = to
        self._waits, self._triggered = waits, triggered
        self._messages: Channel[LiveFrame] = Channel(_WAITING)
        self.offered = self.sent = self.failed = 0
        # Overtaken messages, counted by the offering and by the sending thread.
        self._pushed_out = self._passed_over = 0
        self._took = 0.0  # s, duration of the last sending
        self.latencies = Latencies()
        self._fails = False
        self._thread = threading.Thread(target=self._send_all, name=f"send {self.name}", daemon=True)
        self._thread.start()

    def offer(self, message: LiveFrame) -> None:
        """Queue the live values of a frame for sending; if the output has a condition, only if this becomes true at the
        frame.
        """
        if self._condition is not None and not self._condition.becomes_true(message[1]):
            return
        self.offered += 1
        if self._waits:
            self._messages.put(message)
        else:
            self._pushed_out += self._messages.put_newest(message) is not None

    def stop_waiting(self) -> None:
        """Let the stream no longer wait for this output, so that it can end; messages that it still offers count as
        failed.
        """
        if self._waits:
            self._messages.close()

    def close(self) -> None:
        """Send the queued messages and close the output; abandon an output that takes longer than two seconds."""
        self._messages.close()
        self._thread.join(_CLOSING)
        if self._thread.is_alive():
            log.warning("%s: is still sending after %.0f s: it is left behind", self.name, _CLOSING)
        self.failed = self.offered - self.sent - self.overtaken

    @property
    def overtaken(self) -> int:
        """Return the number of messages that were not sent because a newer frame came while the output was busy."""
        return self._pushed_out + self._passed_over

    @property
    def lost(self) -> int:
        """Return the number of messages that were not delivered, as a newer frame overtook them or sending failed."""
        return self.overtaken + self.failed

    def facts(self) -> dict[str, Any]:
        """Return the output's name, its numbers of messages sent, overtaken and failed, and its latencies in ms, for
        the summary and the live page.
        """
        counts = {"sent": self.sent, "overtaken": self.overtaken, "failed": self.failed}
        return {"output": self.name, **counts, "latency_ms": self.latencies.summary()}

    def describe(self) -> str:
        """Return the numbers of messages sent, overtaken and failed, and the latencies, as a sentence for the log."""
        latency = self.latencies.summary()
        return (
            f"{self.name}: {self.sent} sent, {self.overtaken} overtaken by newer frames, {self.failed} failed; "
            f"camera to output ms: median {latency['median']}, p99 {latency['p99']}"
        )

    def _next(self) -> list[LiveFrame]:
        """Wait for a message and return the messages to be sent next: all that are queued, or only the newest if
        sending all would take too long; an empty list at the end of the stream.
        """
        messages: list[LiveFrame] = []
        while (message := self._messages.get(wait=not messages)) is not None:
            messages.append(message)
        if self._waits or self._condition is not None or len(messages) * self._took <= _CATCH_UP:
            return messages
        self._passed_over += len(messages) - 1
        return messages[-1:]

    def _send_all(self) -> None:
        while messages := self._next():
            for message in messages:
                self._send(message)
        try:
            self._output.close()
        except BaseException as error:
            log.warning("%s: closing: %s", self.name, first_line(error))

    def _send(self, message: LiveFrame) -> None:
        stamp, values = message
        frame = stamp._replace(written=unix_now())
        try:
            self._output.send(frame, {name: values[name] for name in self._values})
        except BaseException as error:
            self._took = unix_now() - frame.written
            self.failed += 1
            if not self._fails:
                log.warning("%s: frame %d was not sent: %s", self.name, frame.number, first_line(error))
            self._fails = True
            return
        now = unix_now()
        latency, self._took = now - frame.camera_time, now - frame.written
        self.sent += 1
        self._fails = False
        self.latencies.add(latency)
        if self._condition is not None and self._triggered is not None:
            # The event log may be on a full disk, or closed already.
            with contextlib.suppress(FingerflowError, ValueError):
                self._triggered(frame.number, self._condition.text, latency)
