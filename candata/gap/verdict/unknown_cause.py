"""When the cause is in no library: where it acts, how large it is, what it depends on, and how much is closable."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.gap.fit.comparison import standard_error
from candata.gap.fit.problem import Problem
from candata.gap.force.remedy import CLEARLY, Mended, mended
from candata.gap.force.stopgap import Stopgap, stopgap
from candata.gap.force.suspects import Suspect
from candata.gap.measure.symptoms import LEVEL, acts_on, slides
from candata.gap.replay.replayer import EffectSet, replay_all
from candata.gap.validation.closure import trust
from candata.gap.verdict.verdict import DOUBTED
from candata.schema.report import Gap, Symptom, UnknownCause

Array = NDArray[np.float64]
#: Gives a force when it is first asked for.
Force = Callable[[], Mended | None]
#: Share of the gap below which a force that was fitted tells nothing of where a cause acts. Chosen: commands that get
#: lost are no force, and what was fitted to three of them closed 0.2 % at most; the least of 22 others closed 4.8 %.
LITTLE = 0.02
#: What is named must leave this, in floors and of the gap, for a force to be tried in its place, and what share of that
#: the force may leave more. Chosen: of 24 right names alone and 59 right sets those that left more floors left 0.04 of
#: the gap at most; of 11 others that did leave more, no force came nearer than 2.9 standard errors; to a wind, a magnet
#: and a fading motor that were named as one to three effects one came within 0.5.
SOMETHING, SELDOM, HALF = 0.03, 0.05, 0.5
#: Share of its largest size above which a force counts as acting.
ACTS = 0.25
#: Share of what was seen from which a circumstance is said to hold whenever the force acts.
MOSTLY = 0.7


@dataclass(frozen=True)
class Described:
    """What is known of an unknown cause, and the force that stands in for it.

    Attributes
    ----------
    unknown : Unknown
    stopgap : tuple of EffectSetting
        Empty where no force mends it.
    """

    unknown: UnknownCause
    stopgap: EffectSet


def describe(problem: Problem, world: EffectSet, where: Sequence[Symptom], nearest: str | None) -> Described | None:
    """Return what remains in a world as a force: where, how large, on what it depends; None where none stands out.

    Where the force mends next to nothing, the worst symptom says on what it acts.

    Parameters
    ----------
    problem : Problem
        Episodes, folds, and the score in units of the world's floor.
    world : tuple of EffectSetting
        What the simulator holds already: nothing, or the effects that are named.
    where : sequence of Symptom
        What remains, the worst first.
    nearest : str or None
        The library's nearest effect, to be named as such.
    """
    found = mended(problem, world)
    return described(found, world, where, nearest) if found else None


def described(found: Mended, world: EffectSet, where: Sequence[Symptom], nearest: str | None) -> Described | None:
    """Return the words for the force that mends most of what a world leaves; parameters are those of `describe`."""
    some, best, place = found.problem, found.best, acts_on(where, slides(found.problem.replayer.scene))
    if best.closed < LITTLE and place not in (None, best.suspects[0].place):
        there = [s for s in found.suspects if s.place == place]
        if not there:
            return None
        nominal = replay_all(some.replayer, some.recs, some.begin, [world])[0]
        best = stopgap(some, world, nominal, there[:1])
    return Described(_unknown(some, best, where, nearest), best.settings if best.closed > 0 else ())


def unseating(force: Force, size: Gap, where: Sequence[Symptom], nearest: str) -> Described | None:
    """Return a described force that closes clearly more by itself than what is named: then that is not the cause.

    Asked only where what is named leaves much, in floors and of the gap; None where it stands.

    Parameters
    ----------
    force : callable
        Gives the force that mends most of the nominal world, judged in units of the floor of the world with what is
        named; None where none stands out.
    size : Gap
        What is named closes.
    where, nearest
        As for `describe`.
    """
    if trust(size) >= DOUBTED:
        return None
    alone = force()
    found = described(alone, (), where, nearest) if alone else None
    return found if found and (found.unknown.closable or 0.0) > (size.closed or 0.0) + CLEARLY else None


def outdoing(
    problem: Problem, force: Force, size: Gap, named: EffectSet, where: Sequence[Symptom], nearest: str
) -> Described | None:
    """Return a described force that explains no less than what is named; None where none does.

    Asked where what is named leaves more than right names do: an alias is nearly, but not quite, what it stands for, as
    is the sum of several. What is named is judged where it was fitted, the force on episodes that took no part in its
    fit, and within a standard error of their difference. Parameters are those of `unseating`, the problem in the same
    units, and the effects that are `named`.
    """
    left = size.after - size.floor
    if left < SOMETHING or 1 - (size.closed or 0.0) < SELDOM:
        return None
    found = force()
    if found is None or found.best.suspects[0].place == "fingertip":
        return None
    own = problem.score.take(found.which).size(problem.residuals([named])[0][found.which])
    more = found.best.size - own
    alike = more.mean() <= min(standard_error(more), HALF * (own.mean() - 1))
    return described(found, (), where, nearest) if alike else None


def _unknown(problem: Problem, best: Stopgap, where: Sequence[Symptom], nearest: str | None) -> UnknownCause:
    """Return the record of what was found."""
    suspect = best.suspects[0]
    force, size = _typical(best)
    closed = round(best.closed, 4)
    text = _words(problem, best, force, size, where)
    if closed > 0:
        text += f"; {_means(suspect)} fitted to it closes {100 * closed:.0f} % of the gap on held-out episodes"
    if nearest is not None:
        text += f"; the nearest effect of the library is {nearest}, which does not explain it"
    return UnknownCause(
        acts_on=suspect.place,
        element=suspect.element if suspect.place != "object" and len(best.suspects) == 1 else None,
        size=float(f"{size:.3g}"),
        unit=_unit(suspect),
        depends_on=_depends_on(problem, best),
        words=text,
        closable=closed,
    )


def _means(suspect: Suspect) -> str:
    """Return what was fitted."""
    return "a correction" if suspect.place == "fingertip" else "a force"


def _unit(suspect: Suspect) -> str:
    """Return the unit of a force."""
    is_torque = suspect.place == "joint" or (suspect.place == "object" and suspect.axes.start > 0)
    return "N m" if is_torque else "N"


def _typical(best: Stopgap) -> tuple[Array, float]:
    """Return the mean force `(A,)` and the median size while it acts; as regressed where playing it does not help."""
    suspect = best.suspects[0]
    scale = best.scale if best.closed > 0 else 1.0
    terms = suspect.by_row[..., list(suspect.description.terms)]
    force = scale * np.einsum("etak,ka->eta", terms, suspect.description.coefficients)
    force = force[np.isfinite(force).all(2)]
    size = np.sqrt((force**2).sum(1))
    acting = size > ACTS * np.quantile(size, 0.95)
    return force[acting].mean(0), float(np.median(size[acting]))


def _depends_on(problem: Problem, best: Stopgap) -> tuple[str, ...]:
    """Return the names of what the force depends on; a constant force that only shows off the support says so."""
    names = best.suspects[0].depends_on
    if best.suspects[0].place == "object" and names[0] == "constant" and _mostly_off(problem, best):
        names = ("off the support", *names[1:])
    return names


def _mostly_off(problem: Problem, best: Stopgap) -> bool:
    """Tell whether the object was off its support nearly whenever a force on it could show."""
    if problem.replayer.scene.file.support is None:
        return False
    sample = best.suspects[0].sample
    seen = np.isfinite(sample.force[..., int(np.abs(best.suspects[0].description.coefficients[0]).argmax())])
    return float(sample.terms[seen][:, 0, 1].mean()) >= MOSTLY


def _words(problem: Problem, best: Stopgap, force: Array, size: float, where: Sequence[Symptom]) -> str:
    """Return one clause: how large, on what, which way, when."""
    suspect, unit = best.suspects[0], _unit(best.suspects[0])
    amount = f"about {size:.2g} {unit}"
    if suspect.place == "object":
        kind = "A pull" if unit == "N" else "A torque"
        return f"{kind} of {amount} on the object{_towards(force)}{_when(problem, best)}"
    if suspect.place == "fingertip":
        moved = any(s.channel != "fingertip_force" and s.p <= LEVEL for s in where)
        kind = "A contact force" if moved else "An error of the reading, nothing in the motion,"
        return f"{kind} of {amount} at fingertip {suspect.element}{_others(best)}{_on(suspect.depends_on)}"
    kind = "A torque" if suspect.place == "joint" else "A force"
    return f"{kind} of {amount} on joint {suspect.element}{_others(best)}{_how(best)}"


def _others(best: Stopgap) -> str:
    """Return where else it acts, in brackets; nothing where it acts on one element alone."""
    others = ", ".join(s.element for s in best.suspects[1:])
    return f" (and others on {others})" if others else ""


def _towards(force: Array) -> str:
    """Return the main direction of a mean force `(3,)`: axes that hold at least half of it."""
    largest = float(np.abs(force).max())
    if largest <= 0:
        return ""
    sides = [f"{'+' if f > 0 else '-'}{a}" for f, a in zip(force, "xyz", strict=True) if abs(f) >= 0.5 * largest]
    return " towards " + " and ".join(sides)


def _when(problem: Problem, best: Stopgap) -> str:
    """Return when a force on the object acts."""
    names = _depends_on(problem, best)
    support = problem.replayer.scene.file.support
    circumstance = {
        "constant": "",
        "off the support": f" whenever it is off the {support}",
        "in contact": " while it is touched",
        "nearness to the support": f" that fades with its height above the {support}",
    }
    first = circumstance.get(names[0])
    return _on(names) if first is None else first + _on(names[1:])


def _on(names: Sequence[str], lead: str = " that depends on") -> str:
    """Return what a force depends on, as a clause."""
    rest = [n for n in names if n != "constant"]
    return f"{lead} {', '.join(rest)}" if rest else ""


def _how(best: Stopgap) -> str:
    """Return how a force on a joint goes with its motion and effort."""
    suspect = best.suspects[0]
    name = suspect.names[suspect.description.terms[0]]
    against = float(suspect.description.coefficients[0, 0]) < 0
    repeat = 2 * np.pi / suspect.wave
    phrase = {
        ("constant",): " that is always there",
        ("position",): " that pulls back like a spring" if against else " that grows away from zero",
        ("velocity",): " against its motion, growing with speed"
        if against
        else " along its motion, growing with speed",
        ("sign of velocity",): " against its motion, like dry friction",
        ("load",): " that takes off a share of the motor's effort" if against else " that adds to the motor's effort",
        ("sign of velocity", "load"): " against its motion, growing with the motor's effort",
        ("sign of velocity", "fingertip force"): " against its motion, growing with the force on its fingertip",
        ("memory", "load"): " that takes off more of the motor's effort the longer it has worked",
        ("time",): " that grows with time",
        ("time", "load"): " that changes the motor's effort with time",
        ("periodic position",): f" that repeats with its position every {repeat:.2g} "
        + ("rad" if suspect.place == "joint" else "m"),
    }[name]
    said = [k.replace("periodic ", "") for k in name]
    return phrase + _on([n for n in suspect.depends_on if n not in said], ", depending also on")
