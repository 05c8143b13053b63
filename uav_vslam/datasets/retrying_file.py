# SPDX-License-Identifier: Apache-2.0
"""A file whose disk may be full for a while: what does not fit waits, and is written when there is room again."""

import io


class RetryingFile:
    """Appends to a file, and never fails before it is closed.

    It holds what it could not write; whoever writes should stop while it is `full`, for that grows.
    """

    def __init__(self, file: io.BufferedWriter) -> None:
        """Take over a file that is open for writing; raises OSError if what was written to it does not fit."""
        self._file = file.detach()  # unbuffered: it says how much of a write has fitted
        self._written = self._file.tell()
        self._waiting = bytearray()
        self.error = ""

    @property
    def full(self) -> bool:
        """Whether some of what was written waits for room; `error` says why."""
        return bool(self._waiting)

    def tell(self) -> int:
        """Return the position behind all that was written, or waits [bytes]."""
        return self._written + len(self._waiting)

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Append; return the number of bytes, all of them."""
        self._waiting += data
        self.retry()
        return len(data)

    def retry(self) -> None:
        """Write what waits, as far as there is room."""
        try:
            while self._waiting:
                count = self._file.write(self._waiting) or 0
                self._written += count
                del self._waiting[:count]
        except OSError as error:
            self.error = error.strerror or str(error)

    def close(self) -> None:
        """Close the file; raises OSError if some of it still does not fit: its end is missing."""
        self.retry()
        self._file.close()
        if self._waiting:
            raise OSError(f"{self.error}; its last {len(self._waiting)} bytes are missing")
