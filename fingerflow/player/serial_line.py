"""Serial line: opened by termios on Linux and macOS, by the package pyserial on Windows."""

import importlib
import os
import sys

from fingerflow.errors import PlayerError
from fingerflow.player.named_objects import load_library

FORM = "serial:DEVICE[@BAUD]"
_BAUD = 115200


class PosixLine:
    """Serial line of Linux or macOS in raw mode: 8 data bits, no parity, no flow control.

    An unknown device, one that is no serial line, or a rate that it does not have raises PlayerError.
    """

    def __init__(self, device: str, baud: int) -> None:
        termios, tty = importlib.import_module("termios"), importlib.import_module("tty")
        rate = getattr(termios, f"B{baud}", None)
        if rate is None:
            raise PlayerError(f"{baud} is no rate of serial lines here; 115200 is usual")
        try:
            # Without O_NONBLOCK, opening would wait for the carrier of a modem.
            self._file = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            raise PlayerError(
                f"{device} cannot be opened ({error.strerror}); is it plugged in, may you open it?"
            ) from None
        try:
            tty.setraw(self._file)
            settings = termios.tcgetattr(self._file)
            settings[2] |= termios.CLOCAL | termios.CREAD
            settings[4] = settings[5] = rate
            settings[6][termios.VMIN], settings[6][termios.VTIME] = 0, 2  # a read returns after 0.2 s without data
            termios.tcsetattr(self._file, termios.TCSANOW, settings)
            os.set_blocking(self._file, True)
        except termios.error:
            os.close(self._file)
            raise PlayerError(f"{device} is no serial line") from None

    def read(self, size: int) -> bytes:
        """Return the bytes that have arrived, at most `size`, after waiting for the first; b"" after 0.2 s without
        data.
        """
        return os.read(self._file, size)

    def write(self, data: bytes) -> None:
        """Write all bytes to the line."""
        while data:
            data = data[os.write(self._file, data) :]

    def close(self) -> None:
        """Close the line."""
        os.close(self._file)


class WindowsLine:
    """Serial line of Windows, opened by the package pyserial."""

    def __init__(self, device: str, baud: int) -> None:
        self._port = load_library("serial", "pyserial").Serial(device, baud, timeout=0.2)
        self.write, self.close = self._port.write, self._port.close

    def read(self, size: int) -> bytes:
        """Return the bytes that have arrived, at most `size`, after waiting for the first; b"" after 0.2 s without
        data.
        """
        # With a larger size pyserial would wait until so many bytes have arrived.
        return self._port.read(min(size, max(1, self._port.in_waiting)))


SerialLine = PosixLine | WindowsLine


def open_line(address: str) -> SerialLine:
    """Open a serial line given as DEVICE or DEVICE@BAUD, by default 115200 baud."""
    device, _, baud = address.partition("@")
    if not device or not (baud or str(_BAUD)).isdigit():
        raise PlayerError(f"{address!r} is no DEVICE[@BAUD]")
    return (WindowsLine if sys.platform == "win32" else PosixLine)(device, int(baud or _BAUD))
