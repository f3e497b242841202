"""Pulls a dataset and stops in the middle of a file: `ROOT REMOTE-JSON NAME FILES`, after so many whole files."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator

from candata.datasets import pull as pulling
from candata.datasets.remotes import open_remote
from candata.schema.registry import RemoteEntry


def main(root: str, remote: str, name: str, whole: str) -> None:
    store = open_remote(RemoteEntry.model_validate_json(remote))
    read, lock, left = store.read, threading.Lock(), [int(whole)]

    def slow(key: str) -> Iterator[bytes]:
        data = b"".join(read(key))
        if "/objects/" in key and threading.current_thread() is not threading.main_thread():
            with lock:
                left[0] -= 1
                stop = left[0] < 0
            if stop:
                yield data[: len(data) // 2]
                print("half", flush=True)
                time.sleep(60)  # killed here
        yield data

    store.read = slow  # type: ignore[method-assign]
    pulling.pull(store, name, root)


if __name__ == "__main__":
    main(*sys.argv[1:])
