"""Recordings that fit the scene only when they are read another way: conjugated, mirrored, exchanged, turned.

Each alternative is judged as the recordings are: the scene is played from the start and under the commands that it
gives, and the difference to what was recorded is compared episode by episode. An alternative holds where it fits far
better in some episodes and far worse in none; it is ruled out where it fits far worse in more episodes than far
better; else the recordings cannot decide.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.recordings import Recordings
from candata.gap.mismatch.alternatives import (
    Alternative,
    count_pairs,
    force_alternatives,
    pair_alternatives,
    pose_alternatives,
)
from candata.gap.mismatch.commands import Paired
from candata.gap.mismatch.force_units import tells_unit
from candata.gap.mismatch.recording_mismatch import Comparison, RecordingMismatch
from candata.gap.mismatch.swaps import CLOSER
from candata.rotation import difference
from candata.scenes import Scene

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Plays recorded commands from recorded starts.
Play = Callable[[Recordings], dict[str, Array]]
#: By how much the other quantities of an episode may fit worse where one fits far better. Measured beside `CLOSER` in
#: worlds of other physics, 60 of three fingers: no alternative came to more than one episode without one against.
WORSE = 1.25
#: Episodes in which an alternative must fit far better, and none may fit far worse.
BETTER_IN = 3
#: Episodes that each alternative is tried on first.
TRIED_ON = 4
#: Misfit from which joints are asked whether two of them were exchanged with their commands: of forces as a share of
#: their size, of the object's place [m]. Chosen: that asks for a simulation of each pair.
FORCE_OFF, PLACE_OFF_M = 0.5, 0.005
#: Pairs of joints up to which they are asked whatever the misfit. Chosen: all pairs of a gripper, a second or two.
FEW_PAIRS = 20
#: Units of what is compared.
UNITS = {"position": "m", "rotation": "rad", "force": "N", "joint": "rad or m"}


@dataclass(frozen=True)
class Votes:
    """How episodes judge an alternative.

    Attributes
    ----------
    better, worse : int
        Episodes in which it fits far better, and far worse.
    gain : float
        Mean logarithm of the ratio of all errors; negative where it fits better.
    text : str
        The quantity that gains most, and its usual error both ways.
    """

    better: int
    worse: int
    gain: float
    text: str

    @property
    def won(self) -> bool:
        """Whether the episodes are for it."""
        return self.better >= BETTER_IN and not self.worse

    @property
    def ruled_out(self) -> bool:
        """Whether the episodes are against it."""
        return self.worse > self.better


def errors(recs: Recordings, played: dict[str, Array]) -> dict[str, Array]:
    """Return `(E,)` the RMS difference of each quantity to what the scene does."""
    out = {}
    if "joint_position" in recs.readings:
        out["joint"] = _rms(recs.readings["joint_position"] - played["joint_position"])
    if "object_pose" in recs.readings:
        real, simulated = recs.readings["object_pose"], played["object_pose"]
        out["position"] = _rms(real[..., :3] - simulated[..., :3])
        out["rotation"] = _rms(difference(real[..., 3:], simulated[..., 3:]))
    if "fingertip_force" in recs.readings:
        out["force"] = _rms(recs.readings["fingertip_force"] - played["fingertip_force"])
    return out


def _rms(off: Array) -> Array:
    """Return `(E,)` the root mean square size of differences `(E, T, ...)`; NaN where nothing was seen."""
    square = (off.reshape(*off.shape[:2], -1) ** 2).sum(-1)
    seen = np.isfinite(square)
    total = np.where(seen, square, 0.0).sum(1) / np.maximum(seen.sum(1), 1)
    return np.where(seen.any(1), np.sqrt(total), np.nan)


def votes(given: dict[str, Array], alternative: dict[str, Array], closer: float = CLOSER) -> Votes:
    """Return how episodes judge an alternative by its errors `(E,)` of each quantity beside those as given."""
    names = list(given)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.stack([np.log(alternative[name] / given[name]) for name in names])
    ratio = np.nan_to_num(ratio, posinf=0.0, neginf=0.0)
    better = (ratio.min(0) < np.log(closer)) & (ratio.max(0) < np.log(WORSE))
    worse = ratio.max(0) > -np.log(closer)
    counted = better if better.any() else np.ones(len(better), bool)
    name = names[int(ratio[:, counted].mean(1).argmin())]
    before, after = (float(np.nanmedian(error[name][counted])) for error in (given, alternative))
    text = f"{name} error {after:.2g} instead of {before:.2g} {UNITS[name]}"
    text += f", in {better.sum()} of {len(better)} episodes looked at"
    return Votes(int(better.sum()), int(worse.sum()), float(ratio.mean()), text)


def judged(alternatives: Iterable[Alternative], recs: Recordings, nominal: dict[str, Array], play: Play) -> Comparison:
    """Return the alternative that holds, the best of several; else those that the recordings cannot decide.

    Each is tried on the most telling episodes, and on all where these speak for it. It must also fit far better than
    an object that nothing touches: in a hand too weak to reach it, whatever misses the object fits.

    Parameters
    ----------
    nominal : dict of str to ndarray
        What the scene does under the recordings as given.
    """
    given, telling = errors(recs, nominal), _telling(recs)
    untouched = errors(recs, _untouched(recs, nominal))
    first = {name: error[telling] for name, error in given.items()}
    won: list[tuple[float, RecordingMismatch]] = []
    undecided: list[Alternative] = []
    for alternative in alternatives:
        if alternative.moves:
            part = alternative.recs.take(telling)
            vote = votes(first, errors(part, play(part)))
            if vote.worse or not vote.better:
                undecided += [alternative] * (not vote.ruled_out)
                continue
        played = play(alternative.recs) if alternative.moves else nominal
        read = errors(alternative.recs, played)
        vote = votes(given, read)
        if vote.won and votes(untouched, read).better >= BETTER_IN:
            won.append((vote.gain, _read_otherwise(alternative, vote)))
        elif not vote.ruled_out:
            undecided.append(alternative)
    if won:
        return Comparison((min(won, key=lambda ranked: ranked[0])[1],))
    return Comparison((), tuple(dict.fromkeys(a.name for a in undecided if a.name)))


def _untouched(recs: Recordings, nominal: dict[str, Array]) -> dict[str, Array]:
    """Return readings of a world in which nothing touches the object; the joints move as the scene's do."""
    out = dict(nominal)
    if "object_pose" in recs.readings:
        pose = recs.readings["object_pose"]
        begin = np.isfinite(pose).all(2).argmax(1)
        out["object_pose"] = np.broadcast_to(pose[np.arange(len(pose)), begin][:, None], pose.shape)
    if "fingertip_force" in recs.readings:
        out["fingertip_force"] = np.zeros_like(recs.readings["fingertip_force"])
    return out


def _read_otherwise(alternative: Alternative, vote: Votes) -> RecordingMismatch:
    """Return the finding that recordings are to be read another way."""
    return RecordingMismatch(
        alternative.kind,
        True,
        alternative.problem,
        "readings as the scene's",
        f"as if {alternative.words}: {vote.text}",
        alternative.fix,
        alternative.channel,
        alternative.elements,
    )


def _telling(recs: Recordings) -> Index:
    """Return the episodes `TRIED_ON` in which the object turns and moves, and fingertips feel, most."""
    rank = np.zeros(len(recs))
    for name, values in recs.readings.items():
        if name == "joint_position":
            continue
        parts = (values[..., :3], values[..., 3:]) if name == "object_pose" else (values,)
        for part in parts:
            moved = np.nanstd(part, axis=1).reshape(len(recs), -1).sum(1)
            rank += np.argsort(np.argsort(np.nan_to_num(moved)))
    return np.sort(np.argsort(-rank, kind="stable")[:TRIED_ON])


def is_off(recs: Recordings, nominal: dict[str, Array]) -> bool:
    """Tell whether forces or the object's place are far from the scene's: then joints may be others than they say."""
    off = errors(recs, nominal)
    if "force" in off and np.nanmedian(off["force"]) > FORCE_OFF * np.nanmedian(_rms(recs.readings["fingertip_force"])):
        return True
    return "position" in off and bool(np.nanmedian(off["position"]) > PLACE_OFF_M)


def place_findings(
    scene: Scene, recs: Recordings, pairs: Paired | None, nominal: dict[str, Array], play: Play
) -> Comparison:
    """Return that joints are exchanged with their commands or poses read another way, else what is undecidable."""
    undecidable: tuple[str, ...] = ()
    if pairs is not None and len(pairs.names) > 1:
        if _tells_nothing(recs, nominal):
            undecidable = ("joints exchanged together with their commands",)
        elif count_pairs(scene, pairs) <= FEW_PAIRS or is_off(recs, nominal):
            exchanged = judged(pair_alternatives(scene, recs, pairs), recs, nominal, play)
            if exchanged.findings:
                return exchanged
            undecidable = exchanged.undecidable
    if "object_pose" not in recs.readings:
        return Comparison((), undecidable)
    poses = judged(pose_alternatives(recs), recs, nominal, play)
    return poses if poses.findings else Comparison((), (*undecidable, *poses.undecidable))


def felt_findings(scene: Scene, recs: Recordings, nominal: dict[str, Array], play: Play) -> Comparison:
    """Return that forces are to be read another way, else what of them is undecidable."""
    felt = judged(force_alternatives(scene, recs), recs, nominal, play)
    if felt.findings:
        return felt
    timing = _instants(recs, nominal, play)
    unit = tells_unit(recs.readings["fingertip_force"], nominal["fingertip_force"])
    units = () if unit else ("forces in another unit",)
    return Comparison(timing.findings, (*felt.undecidable, *timing.undecidable, *units))


def _instants(recs: Recordings, nominal: dict[str, Array], play: Play) -> Comparison:
    """Return that forces are means over a step where instants are declared, or the reverse; or that nothing tells.

    Instants lie half a row after the means before them: so forces are also compared with the means of two rows.
    """
    real, simulated = recs.readings["fingertip_force"], nominal["fingertip_force"]
    whole = (simulated[:, :1], simulated) if recs.instant_force else (simulated, simulated[:, -1:])
    padded = np.concatenate(whole, axis=1)
    between = 0.5 * (padded[:, 1:] + padded[:, :-1])
    other = play(replace(recs, instant_force=not recs.instant_force))["fingertip_force"]
    given = {"force": _rms(real - simulated)}
    tried = [votes(given, {"force": _rms(real - timed)}) for timed in (other, between)]
    best = min(tried, key=lambda vote: vote.gain)
    if not best.won:
        known = any(vote.worse for vote in tried)
        return Comparison((), () if known else ("forces of one instant taken for means, or the reverse",))
    declared, better = ("instant", "mean") if recs.instant_force else ("mean", "instant")
    return Comparison(
        (
            RecordingMismatch(
                "force_timing",
                False,
                f"forces may be {'means over the step' if recs.instant_force else 'of one instant'}",
                f"`force: {declared}`, as declared",
                f"as if `force: {better}`: {best.text}",
                f"say `force: {better}` in map.yaml",
                "fingertip_force",
            ),
        )
    )


def _tells_nothing(recs: Recordings, nominal: dict[str, Array]) -> bool:
    """Tell whether the scene's object and fingertips do nothing that the recordings could contradict."""
    still = {name: np.zeros_like(v) if name == "fingertip_force" else v[:, :1] + 0 * v for name, v in nominal.items()}
    felt = {name: values for name, values in recs.readings.items() if name in ("object_pose", "fingertip_force")}
    part = replace(recs, readings=felt)
    return not felt or not votes(errors(part, nominal), errors(part, still)).worse
