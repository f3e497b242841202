"""Pushes a dataset and prints a line for each file that was sent whole: `ROOT REMOTE-JSON NAME`."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable

from candata.datasets.push import push
from candata.datasets.remotes import open_remote
from candata.schema.registry import RemoteEntry


def main(root: str, remote: str, name: str) -> None:
    store = open_remote(RemoteEntry.model_validate_json(remote))
    write = store.write

    def slow(key: str, chunks: Iterable[bytes], size: int) -> None:
        write(key, chunks, size)
        os.write(1, f"{key}\n".encode())  # whole lines, whichever thread is first
        time.sleep(0.2)  # gives the test the time to kill it between two files

    store.write = slow  # type: ignore[method-assign]
    push(root, store, name)
    print("done", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
