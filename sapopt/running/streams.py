"""Standard streams that never end a run: narrow encodings, closed handles, full disks.

What is worth telling on the way (progress, compile times, help) is not worth losing a result for. Results themselves
are another matter: a standard output that cannot be written to stays an error.
"""

from __future__ import annotations

import io
import os
import sys
from typing import TextIO, cast


class Forgiving(io.TextIOBase):
    """A text stream over another one that drops what cannot be written.

    Parameters
    ----------
    stream : text stream or None
        None, as Python has it for a handle that was closed before the start, drops everything.
    """

    def __init__(self, stream: TextIO | None) -> None:
        self._stream = stream

    @property
    def encoding(self) -> str:  # type: ignore[override]  # typeshed has an attribute
        """That of the stream; it decides how lines are drawn."""
        return "ascii" if self._stream is None else self._stream.encoding or "ascii"

    def writable(self) -> bool:
        """Always."""
        return True

    def isatty(self) -> bool:
        """Whether the stream is a terminal."""
        try:
            return self._stream is not None and self._stream.isatty()
        except ValueError:  # closed
            return False

    def fileno(self) -> int:
        """Handle of the stream, which is where the size of a terminal is asked for."""
        if self._stream is None:
            raise io.UnsupportedOperation("fileno")
        return self._stream.fileno()

    def write(self, text: str) -> int:
        """Write what the encoding holds, and escapes for the rest; a stream that fails is passed over."""
        if self._stream is None:
            return len(text)
        try:
            self._stream.write(text)
        except UnicodeEncodeError:
            self.write(text.encode(self.encoding, "backslashreplace").decode(self.encoding))
        except (OSError, ValueError):
            pass
        return len(text)

    def flush(self) -> None:
        """Flush if the stream can."""
        try:
            if self._stream is not None:
                self._stream.flush()
        except (OSError, ValueError):
            pass


def standard_error() -> TextIO:
    """Standard error as it is now, made forgiving."""
    stream = sys.stderr
    return cast(TextIO, stream if isinstance(stream, Forgiving) else Forgiving(stream))


def forgive() -> None:
    """Make the standard streams of this process forgiving: for programs, not for libraries.

    Standard error drops what it cannot write. Standard output writes escapes for characters that its encoding lacks,
    and where it was closed before the start it goes nowhere; a full disk remains an error there.
    """
    sys.stderr = standard_error()
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - stays open as long as the process
    elif isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
