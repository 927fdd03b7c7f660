"""Force sensor on a serial line: one line of text per sample, its forces in N separated by commas or spaces."""

import time

from fingerflow.player.sensors.sensor import ForceSample, ForceSensor, parse_sample
from fingerflow.player.serial_line import FORM, SerialLine, open_line

ADDRESS = FORM


class SerialSensor:
    """Force sensor that sends lines of text such as "1.25, 0.31": normal force and up to two tangential components, N.

    The time of a sample is the arrival of the end of its line.
    """

    def __init__(self, line: SerialLine) -> None:
        self._line, self._data = line, b""
        self._begun = False
        self.close = line.close

    def read(self) -> ForceSample | None:
        """Return the sample of the next line; None if none came for 0.2 s. Raises ValueError for another text."""
        while b"\n" not in self._data:
            data = self._line.read(4096)
            if not data:
                return None
            self._data += data
        line, _, self._data = self._data.partition(b"\n")
        if not self._begun:  # discards the line during which the port was opened, which is incomplete
            self._begun = True
            return self.read()
        return parse_sample(time.perf_counter(), [float(number) for number in line.replace(b",", b" ").split()])


def open_address(address: str) -> ForceSensor:
    """Open the serial line of an address DEVICE[@BAUD], and return the force sensor that reads it."""
    return SerialSensor(open_line(address))
