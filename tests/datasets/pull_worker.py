"""Pulls a dataset and stops in the middle of a file: `ROOT REMOTE-JSON NAME FILES`, after so many whole files."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Iterator

from candata.datasets import pull as pulling
from candata.datasets.remotes import open_remote
from candata.schema.registry import RemoteEntry


def main(root: str, remote: str, name: str, whole: str) -> None:
    store = open_remote(RemoteEntry.model_validate_json(remote))
    read, fetch = store.read, pulling._fetch_one
    turn = threading.Condition()
    begun, named = [0], [0]

    def slow(key: str) -> Iterator[bytes]:
        data = b"".join(read(key))
        if "/objects/" in key and threading.current_thread() is not threading.main_thread():
            with turn:
                begun[0] += 1
                stop = begun[0] > int(whole)
            if stop:
                yield data[: len(data) // 2]
                with turn:
                    turn.wait_for(lambda: named[0] == int(whole))
                os.write(1, b"half\n")  # a whole line, whichever thread is first
                time.sleep(60)  # killed here
        yield data

    def counted(*arguments: object) -> None:
        fetch(*arguments)  # type: ignore[arg-type]
        with turn:
            named[0] += 1
            turn.notify_all()

    store.read = slow  # type: ignore[method-assign]
    pulling._fetch_one = counted  # type: ignore[assignment]
    pulling.pull(store, name, root)


if __name__ == "__main__":
    main(*sys.argv[1:])
