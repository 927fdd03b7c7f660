"""Opening of text files: the one place that guards against pipes, devices and endless files, and decodes the text."""

import stat
from pathlib import Path

from fingerflow.errors import FingerflowError, first_line

MOST_SETTINGS = 16 << 20  # bytes, more than any file of settings or table of trials has
_KINDS = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
_KINDS |= {stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}
_HDF5 = b"\x89HDF\r\n"  # signature of an HDF5 file
# Byte order marks; that of UTF-32 begins with that of UTF-16, so it stands first.
_MARKS = ((b"\xff\xfe\0\0", "utf-32"), (b"\0\0\xfe\xff", "utf-32"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))


def check_file(path: Path) -> int:
    """Check that a path is a readable file, and return the file size in bytes.

    Raises FingerflowError if it is not a file (opening a pipe would block), does not exist, or may not be read.
    """
    try:
        status = path.stat()
        if file_type := _KINDS.get(stat.S_IFMT(status.st_mode)):
            remedy = "name a file in it" if stat.S_ISDIR(status.st_mode) else "copy its data to a file and name it"
            raise FingerflowError(f"{path}: is {file_type}, not a file; {remedy}")
        with path.open("rb"):
            return status.st_size
    except FileNotFoundError:
        raise FingerflowError(f"{path}: there is no such file (looked in {Path.cwd()})") from None
    except (OSError, ValueError) as error:  # ValueError: the name cannot be that of a file
        raise FingerflowError(
            f"{path}: cannot be opened ({first_line(error)}); make it readable, or copy it to a place where it is"
        ) from error


def read_text(path: Path, remedy: str, most: int = MOST_SETTINGS, fallback: str = "") -> str:
    """Return the text of a file in UTF-8, or in UTF-16 or UTF-32 with a byte order mark, with newlines as line ends.

    remedy: end of the messages, which says what to do. most: bytes that are read at most. fallback: encoding of a file
    that is not UTF-8; "" to refuse it.

    Raises FingerflowError for a file that is missing, a pipe, a device, larger than `most`, or not text.
    """
    try:
        size = check_file(path)
        with path.open("rb") as file:  # Python reserves as many bytes as are to be read
            data = file.read(min(max(size, MOST_SETTINGS), most) + 1)
    except (OSError, FingerflowError) as error:
        reason = error if isinstance(error, FingerflowError) else f"{path}: cannot be read ({first_line(error)})"
        raise FingerflowError(f"{reason}; {remedy}") from None
    if len(data) > most:
        raise FingerflowError(f"{path}: has more than {most} bytes, too many for the text that is expected; {remedy}")
    encoding = next((name for mark, name in _MARKS if data.startswith(mark)), "utf-8-sig")
    if encoding == "utf-8-sig" and b"\0" in data:
        found = "an HDF5 file, as a result is," if data.startswith(_HDF5) else "binary, or UTF-16 without a mark,"
        raise FingerflowError(f"{path}: is {found} where text in UTF-8 is expected; {remedy}")
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        if not fallback or encoding != "utf-8-sig":
            state = f"is not {encoding.removesuffix('-sig').upper()} text ({error.reason})"
            raise FingerflowError(f"{path}: {state}; save it as UTF-8, or {remedy}") from None
        text = data.decode(fallback)
    return text.replace("\r\n", "\n").replace("\r", "\n")
