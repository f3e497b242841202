"""Words for what became of the object in an episode."""

from __future__ import annotations

SUCCESS, FAIL = "success", "fail"
SLIP, DROP, MISS = "slip", "drop", "miss"
#: What `candata.simulate.outcome` tells of an episode that is meant to do something with an object.
OUTCOMES = (SUCCESS, SLIP, DROP, MISS, "topple")
#: What people say of a recorded episode.
JUDGEMENTS = (SUCCESS, SLIP, DROP, MISS)
#: What may be wanted of an episode: an outcome, or any of those that are no success.
WANTED = (*OUTCOMES, FAIL)


def is_wanted(outcome: str | None, wanted: str) -> bool:
    """Tell whether an outcome is the wanted one."""
    return outcome is not None and (outcome != SUCCESS if wanted == FAIL else outcome == wanted)
