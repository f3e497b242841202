"""The file under a log: what was committed stays readable, and the first error of the disk is the last."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from candata.errors import SetupError, UsageError, Where


class Sink:
    """A new file without a buffer of its own: what `write` returned from, a kill of this process does not lose.

    After an error the file is cut back to what was committed last, so that no half record stands at its end.
    """

    def __init__(self, path: Path) -> None:
        """Create the file.

        Raises
        ------
        UsageError
            When it exists.
        SetupError
            When it cannot be made.
        """
        self.failed = False
        self._path, self._at, self._committed = path, 0, 0
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        except FileExistsError:
            if not path.parent.is_dir():
                raise UsageError(
                    "the output's folder is a file", where=Where(path=str(path.parent)), fix="choose another --out"
                ) from None
            raise UsageError(
                "the output exists already", where=Where(path=str(path)), fix="choose another --out"
            ) from None
        except OSError as error:
            raise self._error(error) from None

    @contextmanager
    def guarded(self) -> Iterator[None]:
        """Turn an error of the disk into a SetupError, for good: from then on every use raises.

        Raises
        ------
        SetupError
            When the disk takes no more, now or earlier.
        """
        if self.failed:
            raise SetupError("the log is closed after an error of the disk", where=Where(path=str(self._path)))
        try:
            yield
        except OSError as error:
            self.failed = True
            with suppress(OSError):
                os.ftruncate(self._handle, self._committed)
                self._at = self._committed
                os.fsync(self._handle)
            raise self._error(error) from None

    def write(self, data: bytes) -> int:
        """Write all of `data`; raises OSError where the disk does not take it."""
        rest = memoryview(data)
        while rest:
            count = os.write(self._handle, rest)
            rest, self._at = rest[count:], self._at + count
        return len(data)

    def tell(self) -> int:
        """Return the bytes written so far."""
        return self._at

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    def commit(self) -> None:
        """Remember that the file ends with a whole record now."""
        self._committed = self._at

    def sync(self) -> None:
        """Force the file to the disk; raises OSError."""
        os.fsync(self._handle)

    def close(self) -> None:
        """Close the file."""
        with suppress(OSError):
            os.close(self._handle)

    def _error(self, error: OSError) -> SetupError:
        return SetupError(
            "the log cannot be written",
            found=error.strerror or str(error),
            where=Where(path=str(self._path)),
            fix="make room or choose another disk; what was committed is kept, and `candata recover` makes it whole",
        )
