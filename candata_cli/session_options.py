"""What the options of `record-real` that mark episodes ask for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from candata_cli.outputs import check_output

if TYPE_CHECKING:
    from candata.record.recover import RecoveredLog
    from candata.record.session import SessionPlan
    from candata.record.session_run import RunningSession
    from candata.schema.episode import ContactRule


def check_session(
    out: Path | None,
    folder: Path | None,
    episodes: int | None,
    gap_s: float | None,
    on_contact: bool,
    silence_s: float | None,
) -> Path:
    """Return the log to write: `out`, or the one in a session's folder.

    Raises
    ------
    UsageError
        When neither or both are given, a session's option stands without one, or the output stands.
    SetupError
        When it cannot be written.
    """
    from candata.errors import UsageError
    from candata.record.session_run import LOG_NAME

    if (out is None) == (folder is None):
        both_text = "both" if out is not None else "neither"
        raise UsageError("give --out LOG, or --session DIR", expected="one of them", found=both_text)
    if folder is None:
        options = {
            "--episodes": episodes,
            "--gap": gap_s,
            "--start-on-contact": on_contact or None,
            "--silence": silence_s,
        }
        lone_names = [name for name, value in options.items() if value is not None]
        if lone_names:
            raise UsageError(f"only a session takes {lone_names[0]}", fix="give --session DIR instead of --out")
        check_output(out, "new")  # type: ignore[arg-type]
        return out  # type: ignore[return-value]
    check_output(folder, "new", "--session")
    return folder / LOG_NAME


def session_plan(
    episodes: int | None, gap_s: float | None, on_contact: bool, duration_s: float | None
) -> tuple[SessionPlan, float | None]:
    """Return the plan of a session, and how long the whole recording lasts [s]; None: until it is ended.

    Raises
    ------
    UsageError
        When the schedule lacks the length of an episode, or a rest stands where nothing marks the session by itself.
    """
    from candata.errors import UsageError
    from candata.record.session import SessionPlan

    if gap_s is not None and episodes is None and not on_contact:
        raise UsageError("--gap does nothing in a session by keys", fix="give --episodes N, or --start-on-contact")
    gap = 1.0 if gap_s is None else gap_s
    if on_contact or episodes is None:
        return SessionPlan(episodes, None, gap, on_contact), duration_s
    if duration_s is None:
        raise UsageError("--episodes needs the length of an episode", fix="give --duration S, or --start-on-contact")
    return SessionPlan(episodes, duration_s, gap, on_contact), None


def contact_rule(threshold_n: float, release_n: float | None) -> ContactRule:
    """Return the rule of contact.

    Raises
    ------
    UsageError
        When a force is not above zero, or the release is above the threshold.
    """
    from candata.errors import UsageError
    from candata.schema.episode import ContactRule

    release = threshold_n if release_n is None else release_n
    if not 0 < release <= threshold_n < float("inf"):
        raise UsageError(
            "--release and --threshold do not make a rule of contact",
            expected="0 < release <= threshold [N]",
            found=f"release {release:g}, threshold {threshold_n:g}",
        )
    return ContactRule(threshold_n=threshold_n, release_n=release_n)


@contextmanager
def running_session(
    folder: Path | None, plan: SessionPlan, has_panel: bool, say: Callable[[str], None]
) -> Iterator[RunningSession | None]:
    """Yield the session with the keys of the terminal, None where no folder is given; makes the folder."""
    if folder is None:
        yield None
        return
    from candata.record.session import KEY_WORDS
    from candata.record.session_run import RunningSession
    from candata_cli.keys import typed_keys

    with typed_keys() as (typed, problem):
        if problem:
            say(f"keys are off: {problem}")
        elif not has_panel:
            say(KEY_WORDS)
        yield RunningSession(plan, typed, say, f"keys are off: {problem}" if problem else KEY_WORDS)


def report_rows(facts: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the rows of a report that tell of its session; none where there is none."""
    if "session" not in facts:
        return []
    from candata.record.drift import drift_text
    from candata.schema.session import DriftCheck

    kept = [episode for episode in facts["episodes"] if not episode["discarded"]]
    counts = Counter(episode["outcome"] or "not judged" for episode in kept)
    words = ", ".join(f"{count} {outcome}" for outcome, count in counts.items()) or "none"
    discarded, stray = len(facts["episodes"]) - len(kept), facts["stray_marks"]
    words += (f"; {discarded} discarded" if discarded else "") + (f"; {stray} marks fit no episode" if stray else "")
    drift = "not checked" if facts["drift"] is None else drift_text(DriftCheck.model_validate(facts["drift"]))
    return [("episodes", words), ("drift", drift)]


def restored_session(report: RecoveredLog) -> Path | None:
    """Return the session's file, written beside a recovered log; None where the log is of no session."""
    from candata.errors import DataError
    from candata.record.log_messages import EVENTS
    from candata.record.session_run import restore_session_file

    if EVENTS not in report.messages:
        return None
    try:
        return restore_session_file(Path(report.out))
    except DataError:  # a file of another program that has such a topic
        return None
