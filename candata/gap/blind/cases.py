"""Blind cases on disk: a folder a case that tells nothing of its label.

A case is a folder that anybody can read, and make: a candata dataset with a `case.json` beside its files,

    {"name": "case-0001", "scene": "xhand_tabletop", "scene_digest": null, "episodes": 20, "sealed": "<sha256>"}

and the labels of all cases are one file apart, `{"salt": "<64 hex digits>", "labels": {"case-0001": "<JSON text>"}}`,
whose texts are `Label` records. `sealed` is sha256 over the bytes of the text and of the salt.
`schemas/case.schema.json` and `schemas/labels.schema.json` say every field.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from mujoco.batch import Batch

from candata.datasets import append, create_dataset
from candata.datasets.drafts import draft_beside, place
from candata.effects import Forces
from candata.errors import UsageError, Where
from candata.gap.blind.labels import parsed
from candata.gap.blind.outside_causes import CAUSES
from candata.gap.data.noise import scaled_noise
from candata.gap.verdict.findings import lasting
from candata.scenes import Scene, load_scene
from candata.schema.bench import CaseFile, Label, LabelsFile, OutsideCause
from candata.schema.episode import Episode
from candata.schema.json_text import parse_json
from candata.schema.manifest import Lineage
from candata.simulate.crew import Crew, alone
from candata.simulate.episodes import EpisodeJob, make_episodes
from candata.simulate.jobs import possible_policies
from candata.simulate.loop import Alter
from candata.simulate.seal import commitment
from candata.simulate.world import Filter, Worlds

CASE, CASES = "case.json", "cases"
Told = Callable[[str], None]


def missing_cases(out: Path, sealed: LabelsFile) -> dict[str, str]:
    """Return the labels of the cases that are not yet made, by the case's name."""
    return {n: t for n, t in sealed.labels.items() if not (out / CASES / n / CASE).exists()}


def make_cases(
    out: Path,
    scene: str,
    sealed: LabelsFile,
    *,
    seed: int,
    episodes: int,
    duration_s: float,
    crew: Crew = alone,
    told: Told = lambda name: None,
) -> list[Path]:
    """Return the folders of all cases, those that are missing made; `told` hears the name of each new one.

    All cases share their commands; noise and hidden world are each case's own.
    """
    folder, world = (out / CASES).resolve(), lasting(scene)
    missing = missing_cases(out, sealed)
    tasks = [
        (str(folder / name), world, text, commitment(text, sealed.salt), seed, episodes, duration_s)
        for name, text in missing.items()
    ]
    for name in crew(make_case, tasks):
        told(name)
    return [out / CASES / name for name in sealed.labels]


def make_case(folder: str, scene_name: str, text: str, sealed: str, seed: int, episodes: int, duration_s: float) -> str:
    """Return the name of a case after its folder was written, whole or not at all.

    Parameters
    ----------
    folder : str
        Where the case goes.
    scene_name : str
        What `load_scene` takes.
    text, sealed : str
        The label as canonical JSON, and its commitment.
    seed, episodes : int
        Seed of the commands, the same in all cases; how many episodes.
    duration_s : float
        Length of an episode.
    """
    path, scene = Path(folder), load_scene(scene_name)
    label = Label.parse(parse_json(text), path)
    policies = possible_policies(scene)
    plans = [
        EpisodeJob(
            f"episode-{i:04d}", i, policies[i % len(policies)], seed, label.effects, hidden=True, noise_seed=label.seed
        )
        for i in range(episodes)
    ]
    made = hidden_world(scene, label, plans, duration_s)
    shutil.rmtree(path, ignore_errors=True)
    case = CaseFile(
        name=path.name,
        scene=_seen_from(scene_name, path),
        scene_digest=scene.digest,
        episodes=episodes,
        sealed=sealed,
        noise_declared=label.noise != "undeclared",
    )
    with draft_beside(path) as drafts:
        draft = drafts / path.name
        create_dataset(draft, path.name)
        append(draft, made, Lineage(operation="blind case", sealed=sealed))
        (draft / CASE).write_text(case.model_dump_json(indent=1) + "\n")
        place(draft, path)
    return path.name


def hidden_world(scene: Scene, label: Label, plans: Sequence[EpisodeJob], duration_s: float = 0.0) -> list[Episode]:
    """Return recordings of a case's world: what the real rig is to a robot.

    Parameters
    ----------
    scene : Scene
        The scene with the noise that it declares, whatever a diagnosis is told.
    label : Label
        The truth.
    plans : sequence of Job
        What is played, with the label's effects.
    duration_s : float
        Length of an episode [s]; a motion has its own.
    """
    alter, declared = alter_with(scene, label.outside), scene.file.noise
    noise = declared if declared is None or label.noise_factor == 1 else scaled_noise(declared, label.noise_factor)
    return make_episodes(scene, plans, duration_s=duration_s, noise=noise, alter=alter)


def _seen_from(scene: str, folder: Path) -> str:
    """Return a scene's file relative to a case's folder; a built-in scene's name as it is."""
    return os.path.relpath(scene, folder) if Path(scene).suffix in (".yaml", ".yml") else scene


def read_cases(folder: Path) -> dict[Path, CaseFile]:
    """Return the cases of a folder, by name.

    Raises
    ------
    UsageError
        When there is none, or a `case.json` is not valid or not its folder's.
    """
    found = sorted(path.parent for path in folder.glob(f"*/{CASE}") if not path.parent.name.startswith("."))
    if not found:
        raise UsageError("no cases", expected=f"folders with a dataset and a {CASE}", where=Where(path=str(folder)))
    cases = {path: CaseFile.parse(parsed(path / CASE), path / CASE) for path in found}
    for path, case in cases.items():
        if case.name != path.name:
            raise UsageError(
                "a case bears another name than its folder",
                expected=path.name,
                found=case.name,
                where=Where(path=str(path / CASE)),
            )
    return cases


def scene_of(folder: Path, case: CaseFile) -> str:
    """Return what `load_scene` takes for a case's scene."""
    return str((folder / case.scene).resolve()) if Path(case.scene).suffix in (".yaml", ".yml") else case.scene


def alter_with(scene: Scene, outside: OutsideCause | None) -> Alter | None:
    """Return what adds an outside cause to the worlds of a batch; None for none."""
    return None if outside is None else partial(_altered, scene, outside)


def _altered(scene: Scene, outside: OutsideCause, batch: Batch, worlds: Worlds) -> Worlds:
    """Return the worlds with the cause's filter behind those of the effects."""
    cause = CAUSES[outside.name]
    own = Filter(cause.apply, cause.start(scene, outside, batch))
    if cause.kind == "command":
        return replace(worlds, command=(*worlds.command, own))
    if cause.kind == "force":
        return replace(worlds, force=(*worlds.force, replace(own, apply=partial(_added, cause.apply))))
    return replace(worlds, reading=(*worlds.reading, own))


def _added(apply: Callable[[Any, Any], tuple[Any, Any]], state: Any, x: Forces) -> tuple[Any, Forces]:
    """Return the state and the forces with the cause's added to them."""
    state, force = apply(state, x.added)
    return state, x._replace(added=force)
