"""The other side of `benchmarks/windows.py`: answers questions about a foreign loader, in that loader's environment.

A line of JSON a question on stdin, a line a answer on stdout: `{"do": "time", "windows": [[episode, first row], ...]}`
gives CPU seconds, `{"do": "values", ...}` what the loader gives for these windows. Needs no candata.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

#: (episode, first row) of each window.
Places = Sequence[Sequence[int]]


def serve(name: str, ways: Mapping[str, Callable[[Places], Iterable[Mapping[str, Any]]]], opened_s: float) -> None:
    """Answer until stdin ends; a way is `places -> batches`, each a mapping of channel to (B, rows, ...)."""
    out, sys.stdout = sys.stdout, sys.stderr  # what a library prints is no answer
    print(json.dumps({"name": name, "ways": list(ways), "opened_s": opened_s}), file=out, flush=True)
    for line in sys.stdin:
        asked = json.loads(line)
        way, places = ways[asked["way"]], asked["windows"]
        begin = time.process_time()
        batches = [batch if asked["do"] == "values" else None for batch in way(places)]
        answer: dict[str, Any] = {"cpu_s": time.process_time() - begin}
        if asked["do"] == "values":
            answer["values"] = [{key: _listed(value) for key, value in batch.items()} for batch in batches]
        print(json.dumps(answer), file=out, flush=True)


def _listed(value: Any) -> list:
    """Return an array or tensor as lists of its numbers, (B, rows, columns)."""
    return value.reshape(value.shape[0], value.shape[1], -1).tolist()
