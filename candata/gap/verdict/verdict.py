"""Verdicts: what the evidence allows to say, by the rules of the report."""

from __future__ import annotations

from collections.abc import Sequence

from candata.gap.fit.acceptance import LARGEST, searched_count
from candata.gap.fit.fits import Fit, Members
from candata.gap.search.attribution import Attribution
from candata.gap.validation.closure import REMAINING, trust
from candata.schema.report import Gap, Symptom, UnknownCause, Verdict

#: Share of the gap that must close for `explained`, and for naming anything.
EXPLAINED, PARTLY = 0.8, 0.3
#: Trust below which a set passes no more for the little that it leaves: it is wrong more often than right. Record 43.
DOUBTED = 0.5
#: Share of a gap below which one name alone explains nothing, nor several a small gap, however little remains: the
#: remainder is the larger part. Chosen: of 131 right names alone the least closed 0.72; a fingertip that repeats old
#: readings, named as a lag, 0.37 to 0.43, and a magnet named as mass and friction that grows with load as damping 0.49.
#: So much must close on the other episodes, and anything on all, where less than `PARTLY` does for the sake of a few.
LARGER_PART = 0.5
#: Where a few episodes hold most of what remains, the share of the gap of all others that a set of no more names than
#: are searched for must close to pass although it leaves little and is not trusted. Chosen: of the 1.08 floors of a
#: mass and a solver setting, both near the truth, 0.25 stayed open, most of them in one of 20 episodes, and of the gap
#: of the others more than this closed; of eight causes in no library none is let through.
ALL_BUT_A_FEW = 0.9


def verdict(found: Attribution, size: Gap, measured: Members = ()) -> Verdict:
    """Return the verdict word for what was found and how far the gap shrank; what was `measured` is not counted."""
    if found.chosen is None:
        return "unknown_effect" if found.remains else "no_gap"
    closed = size.closed or 0.0
    little = size.after - size.floor <= REMAINING
    # Many names fit what no name explains: of a friction that grows with load four took 0.70.
    many = searched_count(found.chosen.members, measured) > LARGEST
    loose = trust(size) < DOUBTED or many
    faint = little and closed < EXPLAINED and (loose or closed < LARGER_PART)
    elsewhere = size.closed_elsewhere or 0.0
    few = closed > 0 and elsewhere >= LARGER_PART
    least = LARGER_PART if len(found.chosen.members) == 1 else PARTLY
    # Where the interval of the share reaches `EXPLAINED`, the gap is too small for it: the held-out gain has decided.
    unsure = little and closed > 0 and not loose and (size.high or 0.0) >= EXPLAINED
    spared = few and elsewhere >= ALL_BUT_A_FEW and not many
    if not unsure and ((faint and not spared) or (closed < least and not few)):
        return "unknown_effect"
    if len(found.tied) > 1:
        return "ambiguous"
    return "explained" if closed >= EXPLAINED or (little and (unsure or not faint)) else "partly_explained"


def unnamed_cause(
    word: Verdict,
    found: Attribution,
    where: Sequence[Symptom],
    place: str | None,
    size: float | None,
    unit: str | None,
) -> UnknownCause | None:
    """Return what is not known: filled for `unknown_effect` and `partly_explained`."""
    if word not in ("unknown_effect", "partly_explained"):
        return None
    depends = tuple(dict.fromkeys(s.phase for s in where if s.phase))[:3]
    element = where[0].element if where else None
    return UnknownCause(
        acts_on=place,  # type: ignore[arg-type]
        element=element,
        size=size,
        unit=unit,
        depends_on=depends,
        words=_words(word, found, where, size, unit),
    )


def _words(word: Verdict, found: Attribution, where: Sequence[Symptom], size: float | None, unit: str | None) -> str:
    """Return one clause about what remains, and the nearest effect where none is named."""
    if where:
        first = where[0]
        text = f"A difference remains in {first.channel.replace('_', ' ')} {first.element or ''}".rstrip()
        text += f" during {first.phase}" if first.phase else ""
        text += f", typically {size:.3g} {unit}" if size is not None else ""
    else:
        text = "A difference remains that no single channel or phase stands out in"
    if word == "unknown_effect" and found.first.fits:
        nearest = found.first.fits[0]
        text += f"; the nearest effect of the library is {nearest.labels[0]}, which does not explain it"
    return text


def class_of(fits: Sequence[Fit]) -> tuple[str, ...]:
    """Return the sorted names of candidates that cannot be told apart."""
    return tuple(sorted(f.labels[0] for f in fits))
