"""Text of files that are read in pieces: some megabytes of whole lines at a time."""

from __future__ import annotations

import re
from typing import Final

from nanite_rs.exceptions import FormatError

#: Bytes that are read at a time.
BLOCK: Final = 1 << 23


class Lines:
    """A text in blocks of whole lines, which end with a line feed."""

    def __init__(self, path: str, offset: int = 0, line: int = 1) -> None:
        self._path, self._at, self._held = path, offset, b""
        #: The number of the line that comes next.
        self.line = line

    def _more(self) -> bool:
        """Read on; false at the end of the file."""
        with open(self._path, "rb") as file:
            file.seek(self._at)
            data = file.read(BLOCK)
            # The two bytes of a line end stay together.
            if data.endswith(b"\r"):
                data += file.read(1)
        self._at += len(data)
        if b"\r" in data:
            data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        self._held += data
        return bool(data)

    def block(self) -> bytes:
        """Return the next lines; nothing at the end."""
        while b"\n" not in self._held:
            if len(self._held) > 8 * BLOCK:
                raise FormatError(f"{self._path}: line {self.line}: it has more than {8 * BLOCK} bytes")
            if not self._more():
                out, self._held = self._held, b""
                break
        else:
            if len(self._held) < BLOCK // 2:
                self._more()
            end = self._held.rindex(b"\n") + 1
            out, self._held = self._held[:end], self._held[end:]
        return out

    def back(self, data: bytes) -> None:
        """Take back what comes next."""
        self._held = data + self._held

    def passed(self, data: bytes) -> None:
        """Count the lines of what was read."""
        self.line += data.count(b"\n")

    def rows(self, most: int) -> tuple[bytes, int]:
        """Return lines with so many rows at most, and how many: lines that are not blank."""
        data = self.block()
        lines = data.split(b"\n")
        full = [k for k, line in enumerate(lines) if line.strip(b" \t\x0b\x0c\x00\x1a")]
        if len(full) > most:
            end = full[most]
            self.back(b"\n".join(lines[end:]))
            return b"\n".join(lines[:end]) + b"\n" * bool(end), most
        return data, len(full)


def shifted(error: FormatError, lines: int, rows: int = 0, of: int = 0, at: int = 0) -> FormatError:
    """Return an error of a part of a file with the numbers that lines, rows and bytes have in the whole."""
    text = re.sub(r"\bline (\d+)", lambda m: f"line {int(m[1]) + lines}", str(error), count=1)
    text = re.sub(r"\b(row|facet) (\d+)", lambda m: f"{m[1]} {int(m[2]) + rows}", text, count=1)
    text = re.sub(r"\bbyte (\d+)", lambda m: f"byte {int(m[1]) + at}", text)
    if of:
        text = re.sub(r"(row \d+) of \d+", rf"\1 of {of}", text, count=1)
    return type(error)(text)
