"""Blind cases on disk: labels sealed first, then a folder a case that tells nothing of its label.

A case is a folder that anybody can read, and make: a candata dataset with a `case.json` beside its files,

    {"name": "case-0001", "scene": "xhand_tabletop", "scene_digest": null, "episodes": 20, "sealed": "<sha256>"}

and the labels of all cases are one file apart, `{"salt": "<64 hex digits>", "labels": {"case-0001": "<JSON text>"}}`,
whose texts are `Label` records. `sealed` is sha256 over the bytes of the text and of the salt.
`schemas/case.schema.json` and `schemas/labels.schema.json` say every field.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from candata.datasets import append, create_dataset
from candata.datasets.drafts import draft_beside, place
from candata.errors import DataError, UsageError, Where
from candata.gap.blind.draws import draw_labels
from candata.gap.blind.outside import alter_with
from candata.gap.data.noise import scaled_noise
from candata.gap.verdict.conclusion import lasting
from candata.scenes import Scene, load_scene
from candata.schema.bench import CaseFile, Kind, Label, LabelsFile
from candata.schema.episode import Episode
from candata.schema.json_text import parse_json, read_json
from candata.schema.manifest import Lineage
from candata.simulate.crew import Crew, alone
from candata.simulate.episodes import EpisodeJob, make_episodes
from candata.simulate.jobs import possible_policies
from candata.simulate.seal import canonical, commitment, new_salt, secret_number, write_once

CASE, LABELS, CASES = "case.json", "sealed.json", "cases"
#: Salt of cases that are kept to train on: no secret, so that the same command draws the same cases anywhere.
TRAINING_SALT = hashlib.sha256(b"candata training bench").hexdigest()
Told = Callable[[str], None]


def seal_labels(
    out: Path,
    scene: Scene,
    counts: dict[Kind, int],
    *,
    seed: int,
    episodes: int,
    duration_s: float = 3.2,
    only: Sequence[str] = (),
    live: Callable[[], Sequence[str]] = lambda: (),
    noise: str = "declared",
    salt: str | None = None,
) -> LabelsFile:
    """Return the sealed labels of a run: those that stand in `out`, or fresh ones from a secret salt.

    Parameters
    ----------
    out : Path
        Folder of the run.
    scene : Scene
        The nominal scene.
    counts : dict of Kind to int
        Cases of each kind.
    seed, episodes : int
        Seed of the commands (and, with the salt, of the draw); episodes of each case.
    duration_s : float
        Length of an episode.
    only : sequence of str
        Effects that were asked for; all, when empty.
    live : callable
        Returns the effects to draw from; asked for a fresh draw alone.
    noise : str
        What diagnoses are told of the sensors' noise, as in `draw_labels`.
    salt : str, optional
        The secret, hex of 32 bytes; random by default.

    Raises
    ------
    UsageError
        When the run that stands there was asked for something else, or when the scene declares no noise that could be
        wrong or withheld.
    """
    if noise != "declared" and scene.file.noise is None:
        raise UsageError(
            f"scene {scene.name} declares no noise",
            expected="`noise` in the scene file",
            found=f"cases with noise that is {noise}",
            fix="leave --noise out, or declare the sensors' noise",
        )
    asked: dict[str, str | int | float] = {
        "scene": scene.name,
        "scene_digest": scene.digest,
        "seed": seed,
        "episodes": episodes,
        "duration_s": duration_s,
        "only": ",".join(only),
        **{f"count_{k}": n for k, n in counts.items()},
        **({} if noise == "declared" else {"noise": noise}),
    }
    path = out / LABELS
    if not path.exists():
        secret = salt or new_salt()
        rng = np.random.default_rng(secret_number(seed, secret, "blind cases"))
        drawn = draw_labels(scene, counts, rng, live() or only, noise)
        write_once(path, LabelsFile(salt=secret, asked=asked, labels={one.case: canonical(one) for one in drawn}))
    return standing_labels(out, asked, salt)


def standing_labels(out: Path, asked: dict[str, str | int | float], salt: str | None = None) -> LabelsFile:
    """Return the labels that stand in the folder of a run.

    Raises
    ------
    UsageError
        When the run that stands there was asked for something else, or drawn from another salt than a given one.
    """
    found = read_labels(out / LABELS)
    if salt not in (None, found.salt):
        raise UsageError(
            "the folder holds cases that were drawn from another salt",
            expected="no cases, or those of the same command",
            found="other cases",
            where=Where(path=str(out)),
            fix="choose another folder",
        )
    other = [k for k in {*asked, *found.asked} if asked.get(k) != found.asked.get(k)]
    if other:
        raise UsageError(
            "the folder holds a run that was asked for something else",
            expected=", ".join(f"{k} {found.asked.get(k)}" for k in sorted(other)),
            found=", ".join(f"{k} {asked.get(k)}" for k in sorted(other)),
            where=Where(path=str(out)),
            fix="repeat the first command, or choose another --out",
        )
    return found


def read_labels(path: Path) -> LabelsFile:
    """Return the record of a labels file.

    Raises
    ------
    UsageError
        When the file is missing or is no labels file.
    """
    return LabelsFile.parse(_json(path), path)


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
    cases = {path: CaseFile.parse(_json(path / CASE), path / CASE) for path in found}
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


def open_labels(cases: dict[Path, CaseFile], sealed: LabelsFile) -> dict[str, Label]:
    """Return the label of each case, each checked against the hash that its case carries.

    Raises
    ------
    DataError
        When a case has no label, or a label is not the one that was sealed.
    """
    out = {}
    for folder, case in cases.items():
        text = sealed.labels.get(case.name)
        if text is None:
            raise DataError("a case has no label", expected=case.name, where=Where(path=str(folder)))
        if commitment(text, sealed.salt) != case.sealed:
            raise DataError(
                f"the label of {case.name} is not the one that was sealed",
                expected=f"sealed {case.sealed[:12]}",
                found=f"sealed {commitment(text, sealed.salt)[:12]}",
                where=Where(path=str(folder)),
                fix="give the labels that were written beside these cases",
            )
        out[case.name] = Label.parse(parse_json(text), case.name)
    return out


def _json(path: Path) -> object:
    """Return the content of a JSON file."""
    if not path.is_file():
        raise UsageError(f"no file {path.name}", where=Where(path=str(path)))
    return read_json(path)
