"""Where a replay of a hand starts: at rest, or in motion a few rows later, with all that no position tells."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.noise import SMALLEST, SMALLEST_SLIDE_M
from candata.gap.data.recordings import Recordings
from candata.gap.data.robust_loss import rho
from candata.gap.replay.memory import State, hides_state, integrated, lead_rows, led_state, recorded_dofs, settled
from candata.gap.replay.shooting import HORIZON_S, Shown, shot, unknowns
from candata.gap.replay.smoother import fitted, half_rows, pose_fit, pose_of, tangent, twist_of
from candata.rotation import difference, exp, multiply
from candata.scenes import Scene
from candata.simulate import rollout

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Rows over which a still object's pose is averaged at most (0.1 s at 80 Hz).
STILL_ROWS = 8
#: Chi-squared by which one account must be nearer than another to tell: three standard errors of one number. Chosen.
SURELY = 9.0
#: The same where most recordings speak against it: ten standard errors. Chosen: none of 72 nominal episodes of two
#: hands that begin at rest counts as begun in motion so.
UNDOUBTED = 100.0
#: Rows over which they are compared, in halves of the smoother's window. Chosen: a finger forgets its start in 0.1 s.
AFTER = 3


class HandStarts(NamedTuple):
    """Row `(E,)` from which each episode is replayed, the state there, and the state at row 0 that leads there."""

    rows: Index
    start: State
    first: State


def hand_starts(
    scene: Scene, recs: Recordings, moving: NDArray[np.bool_] | None = None, threads: int = 1
) -> HandStarts:
    """Return where the episodes of a hand start.

    Recorded positions tell the state of joints and object: at rest their mean over the first rows, in motion a
    polynomial through the rows around the start. An episode that begins in motion starts a few rows later, as no row
    before its first tells its speed. It does where its positions change over the first rows, and a replay from there
    follows the next rows better than one from rest.

    What no position tells is settled: joints that hang on recorded ones, activations and past commands are simulated
    with the recorded ones held where they were, or led along their recorded path. What even that leaves open is found
    by shooting. Where it is known, `moving (E,)` says which episodes begin in motion.
    """
    rest, row = _at_rest(scene, recs, threads), lead_rows(scene)
    index, rows = np.flatnonzero(_may_move(scene, recs) if moving is None else moving), np.zeros(len(recs), int)
    if not len(index):
        return HandStarts(rows, rest, rest)
    some = recs.take(index)
    start, first = _in_motion(scene, some, rest.take(index), threads)
    chosen = np.ones(len(index), bool)
    if moving is None:
        nearer = _distance(scene, some, rest.take(index), 0, threads) - _distance(scene, some, start, row, threads)
        chosen = _begins_moving(nearer, len(recs))
    rows[index[chosen]] = row
    start, first = (_put(rest, index[chosen], state.take(chosen)) for state in (start, first))
    return HandStarts(rows, start, first)


def _put(state: State, index: Index, other: State) -> State:
    """Return the state with that of some episodes replaced."""
    out = State(*(values.copy() for values in state))
    for values, new in zip(out, other, strict=True):
        values[index] = new
    return out


def _begins_moving(nearer: Array, count: int) -> NDArray[np.bool_]:
    """Return which episodes begin in motion, by how much nearer in chi-squared `(n,)` a start in motion comes.

    Recordings are cut alike. Where most of `count` episodes surely begin in motion, one does that does not tell; else
    only one that leaves no doubt.
    """
    if 2 * (nearer > SURELY).sum() > count:
        return np.asarray(nearer > -SURELY)
    return np.asarray(nearer > UNDOUBTED)


def _distance(scene: Scene, recs: Recordings, state: State, begin: int, threads: int) -> Array:
    """Return `(E,)` twice the Student-t loss of rows after the lead under an open-loop replay from row `begin`.

    That is chi-squared of what noise leaves, and a logarithm of what a contact does that came out otherwise. Rows
    before the end of the lead, of a start at rest, count by what they surely leave beyond noise.
    """
    half, row = half_rows(scene.file.rate_hz), lead_rows(scene)
    shown = _shown(scene, recs, begin, row + (1 + AFTER) * half, row - half)
    played = rollout(
        scene, shown.commands, state.qpos, state.qvel, [()] * len(recs), memory=state.memory, threads=threads
    ).readings
    apart = [np.zeros((len(recs), shown.joints.shape[1], 0))]
    if "joint_position" in played:
        apart.append((shown.joints - played["joint_position"]) / shown.joint_noise)
    if "object_pose" in played:
        turn = difference(shown.pose[..., 3:], played["object_pose"][..., 3:])
        shift = shown.pose[..., :3] - played["object_pose"][..., :3]
        apart.append(np.concatenate([shift, turn], axis=-1) / shown.pose_noise)
    every, first = 2 * rho(np.concatenate(apart, axis=2).astype(np.float32)).astype(float), row + 1 - begin
    # Rows to which the start in motion was smoothed say nothing for it.
    lead, after = every[:, 1:first], np.nansum(every[:, first + half :], axis=(1, 2))
    count = (np.isfinite(lead) & (lead > 0)).sum((1, 2))
    return after + np.maximum(np.nansum(lead, axis=(1, 2)) - count - np.sqrt(SURELY * 2 * count), 0.0)


def _shown(scene: Scene, recs: Recordings, first: int, last: int, around: int) -> Shown:
    """Return what rows `first` to `last` show, with the noise that a polynomial leaves from row `around` on."""
    joints, pose = _rows(scene, recs, first, last)
    half = half_rows(scene.file.rate_hz)
    near_joints, near_pose = _rows(scene, recs, around, around + 2 * half)
    least = _least(scene)
    noise = fitted(near_joints, half, least.joints).noise, pose_fit(near_pose, half, least.pose)[0].noise
    sizes = [np.where(np.isfinite(n), n, np.inf) for n in noise]
    return Shown(recs.commands[:, first : last + 1], joints, pose, *sizes)


def _rows(scene: Scene, recs: Recordings, first: int, last: int) -> tuple[Array, Array]:
    """Return joints `(E, W, J)` and poses `(E, W, 7)` of rows `first` to `last`; NaN of a channel that is missing."""
    count = len(recs.commands[0, first : last + 1])
    missing = {"joint_position": len(scene.joint_ids), "object_pose": 7}
    joints, pose = (
        recs.readings[name][:, first : last + 1]
        if name in recs.readings
        else np.full((len(recs), count, width), np.nan)
        for name, width in missing.items()
    )
    return joints, pose


def _may_move(scene: Scene, recs: Recordings) -> NDArray[np.bool_]:
    """Return `(E,)` whether an episode may begin in motion: some position surely changes over its first rows.

    Recordings are cut alike: where most episodes move, the others may do so too slowly to be seen.
    """
    half = half_rows(scene.file.rate_hz)
    joints, pose = _rows(scene, recs, 0, 2 * half)
    if joints.shape[1] <= 2 * half:
        return np.zeros(len(recs), bool)
    least = _least(scene)
    moves = fitted(joints, half, least.joints).moves | pose_fit(pose, half, least.pose)[0].moves
    long_enough = recs.lengths > 2 * (half + lead_rows(scene))
    return np.asarray(long_enough & (moves | (2 * moves[long_enough].sum() > long_enough.sum())))


class _Least(NamedTuple):
    """Least noise that is believed of joints `(J,)` [rad or m] and of poses `(6,)` [m, rad]."""

    joints: Array
    pose: Array


def _least(scene: Scene) -> _Least:
    """Return the resolution of the sensors of a scene."""
    joints = np.where(scene.sliding, SMALLEST_SLIDE_M, np.asarray(SMALLEST.joint_position))
    return _Least(joints, np.repeat(SMALLEST.object_pose, 3))


def _at_rest(scene: Scene, recs: Recordings, threads: int) -> State:
    """Return the state at row 0 of episodes that begin at rest."""
    count, model = len(recs), scene.model
    qpos = np.repeat(np.asarray(model.qpos0, float)[None], count, axis=0)
    shown = _shown(scene, recs, 0, STILL_ROWS - 1, 0)
    if "joint_position" in recs.readings:
        seen = _first_seen(shown.joints, qpos[:, scene.joint_qpos])
        qpos[:, scene.joint_qpos] = _at_first(shown.joints, seen, shown.joint_noise)
    if "object_pose" in recs.readings:
        at = scene.object_qpos
        qpos[:, at : at + 7] = _pose_at_first(shown.pose, qpos[:, at : at + 7], shown.pose_noise)
    if not hides_state(scene):
        return State(qpos, np.zeros((count, model.nv)), np.zeros((count, 0)))
    state = settled(scene, qpos, recs.commands[:, 0], threads)
    still = np.zeros((count, model.nv))
    state = state._replace(memory=integrated(scene, state, still, recs.commands[:, 0]))
    return _shot(scene, recs, state, 0, threads)


def _shot(scene: Scene, recs: Recordings, state: State, row: int, threads: int) -> State:
    """Return the state at a row with what neither rest nor lead tells found by shooting."""
    wanted, half = unknowns(scene, row > 0), half_rows(scene.file.rate_hz)
    last = row + max(2 * half, round(HORIZON_S * scene.file.rate_hz))
    if not len(wanted.sizes) or recs.commands.shape[1] <= last:
        return state
    return shot(scene, _shown(scene, recs, row, last, max(row - half, 0)), state, wanted, threads)


class _Path(NamedTuple):
    """Smoothed positions `(E, P)` and velocities `(E, V)` of what was recorded at a row, see `recorded_dofs`."""

    qpos: Array
    qvel: Array


def _smoothed(scene: Scene, recs: Recordings, row: int, rest: Array) -> _Path:
    """Return what was recorded at a row, from the rows around it; as in `rest (E, nq)` where it was not seen."""
    half, rate = half_rows(scene.file.rate_hz), scene.file.rate_hz
    begin = max(0, row - half)
    joints, pose = _rows(scene, recs, begin, begin + 2 * half)
    at, dofs = recorded_dofs(scene)
    qpos, qvel = rest.copy(), np.zeros((len(recs), scene.model.nv))
    least = _least(scene)
    fit = fitted(joints, row - begin, least.joints)
    qpos[:, scene.joint_qpos] = np.where(np.isfinite(fit.position), fit.position, qpos[:, scene.joint_qpos])
    qvel[:, scene.joint_dof] = np.nan_to_num(fit.speed * rate)
    if scene.object_id is not None:
        where, seen = slice(scene.object_qpos, scene.object_qpos + 7), np.isfinite(pose).all((1, 2))
        fit, anchor = pose_fit(pose[seen], row - begin, least.pose)
        # A hand in motion beside an object at rest: a speed within its error would roll a ball away.
        rests = ~fit.moves[:, None]
        mean = tangent(pose[seen], anchor).mean(1)
        fit = fit._replace(position=np.where(rests, mean, fit.position), speed=np.where(rests, 0.0, fit.speed))
        qpos[seen, where] = pose_of(fit, anchor)
        qvel[seen, scene.object_dof : scene.object_dof + 6] = twist_of(fit, qpos[seen, where], rate)
    return _Path(qpos[:, at], qvel[:, dofs])


def _in_motion(scene: Scene, recs: Recordings, rest: State, threads: int) -> tuple[State, State]:
    """Return the state of episodes in motion at the row to which they are led, and at row 0."""
    row, rate = lead_rows(scene), scene.file.rate_hz
    at, dofs = recorded_dofs(scene)
    path = [_smoothed(scene, recs, k, rest.qpos) for k in range(row + 2)]
    first = State(*(values.copy() for values in rest))
    first.qpos[:, at], first.qvel[:, dofs] = path[0]
    if not hides_state(scene):
        start = State(*(values.copy() for values in first))
        start.qpos[:, at], start.qvel[:, dofs] = path[row]
        return start, first
    positions, speeds = (np.stack(parts, 1) for parts in zip(*path[: row + 1], strict=True))
    start = led_state(scene, recs.commands[:, : row + 1], first, positions, speeds, threads)
    start.qpos[:, at], start.qvel[:, dofs] = path[row]
    faster = np.zeros_like(start.qvel)
    faster[:, dofs] = (path[row + 1].qvel - path[row - 1].qvel) * rate / 2
    reached = start.memory
    start = start._replace(memory=integrated(scene, start, faster, recs.commands[:, row]))
    start = _shot(scene, recs, start, row, threads)
    # What hangs on the hand may have moved so at row 0 too; an integrator went from there as far as in the lead.
    others, free = np.setdiff1d(np.arange(scene.model.nq), at), np.setdiff1d(np.arange(scene.model.nv), dofs)
    first.qpos[:, others], first.qvel[:, free] = start.qpos[:, others], start.qvel[:, free]
    acts = unknowns(scene, False).activations
    first.memory[:, acts] += (start.memory - reached)[:, acts]
    return start, first


def _first_seen(rows: Array, fallback: Array) -> Array:
    """Return `(E, D)` the first finite value of each column, else the fallback."""
    finite = np.isfinite(rows)
    at = finite.argmax(1)[:, None]
    return np.where(finite.any(1), np.take_along_axis(rows, at, axis=1)[:, 0], fallback)


def _at_first(rows: Array, fallback: Array, noise: Array) -> Array:
    """Return `(E, D)` where a joint at rest was at the first of rows `(E, W, D)`; the fallback where one was not seen.

    The mean; where that plainly does not fit the noise `(D,)`, the start of what rises from rest (least squares on 1,
    k^2 and k^3 of the row k); where that does not either, the first row.
    """
    steps = np.arange(rows.shape[1], dtype=float)
    basis = np.stack([np.ones_like(steps), steps**2, steps**3], axis=1)
    rising = np.einsum("kw,ewd->ked", np.linalg.pinv(basis), rows)
    mean, risen = rows.mean(1), np.einsum("wk,ked->ewd", basis, rising)
    still, rises = (((rows - fit) ** 2).sum(1) / noise**2 for fit in (mean[:, None], risen))
    free = max(rows.shape[1] - basis.shape[1], 0)
    first = np.where(rises > free + np.sqrt(SURELY * 2 * free), rows[:, 0], rising[0])
    first = np.where(still > rises + SURELY, first, mean)
    return np.where(np.isfinite(rows).all(1), first, fallback)


def _pose_at_first(rows: Array, fallback: Array, noise: Array) -> Array:
    """Return the pose `(E, 7)` at the first of some rows, as `_at_first` does in the tangent space."""
    anchor = _first_seen(rows, fallback)
    first = _at_first(tangent(rows, anchor), tangent(anchor[:, None], anchor)[:, 0], noise)
    return np.concatenate([first[:, :3], multiply(exp(first[:, 3:]), anchor[:, 3:])], axis=1)
