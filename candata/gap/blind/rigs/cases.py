"""Cases in random small scenes: labels drawn and sealed, then a folder a case that brings its own scene."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from candata.datasets import append, create_dataset
from candata.datasets.drafts import draft_beside, place
from candata.gap.blind.cases import CASE, CASES, missing_cases
from candata.gap.blind.labels import LABELS, standing_labels
from candata.gap.blind.rigs.causes import CAUSES
from candata.gap.blind.rigs.design import all_traits
from candata.gap.blind.rigs.planted_world import drawn_cause, planted
from candata.gap.blind.rigs.readings import Planted, episode_reading, episodes, ideal, noisy
from candata.gap.blind.rigs.recording import Drawn, logs, nominal, sane_rig
from candata.scenes.first_load import vouch
from candata.schema.bench import CaseFile, Kind, Label, LabelsFile
from candata.schema.json_text import parse_json
from candata.schema.manifest import Lineage
from candata.simulate.crew import Crew, alone
from candata.simulate.seal import canonical, commitment, new_salt, secret_number, write_once

Told = Callable[[str], None]
WORLD = "random-small"
#: Kinds that are drawn in random small scenes, and how many by default.
COUNTS: dict[Kind, int] = {"null": 300, "one": 200}
#: Keeps the numbers of noise apart from those of the scene.
NOISE_STREAM = 10**6


def seal_rig_labels(
    out: Path,
    counts: dict[Kind, int],
    *,
    seed: int,
    episodes: int,
    duration_s: float | None = None,
    traits: Sequence[str] = (),
    only: Sequence[str] = (),
    crew: Crew = alone,
    told: Told = lambda name: None,
    salt: str | None = None,
) -> LabelsFile:
    """Return the sealed labels of a run: those that stand in `out`, or fresh ones from a secret salt.

    Parameters
    ----------
    out : Path
        Folder of the run.
    counts : dict of Kind to int
        How many nulls and single causes.
    seed, episodes : int
        Seed (with the salt, of everything), episodes of each case.
    duration_s : float, optional
        Length of an episode; each scene's own by default.
    traits : sequence of str
        Traits that take turns; by default half of the nulls are plain, the others take turns through the rest, and
        single causes are plain.
    only : sequence of str
        Causes that take turns; all by default.
    crew : Crew
        Who draws the causes: each is tried in its scene, as it has to matter there.
    told : callable
        Hears of each label.
    salt : str, optional
        The secret, hex of 32 bytes; random by default.

    Raises
    ------
    UsageError
        When the run that stands there was asked for something else.
    """
    asked: dict[str, str | int | float] = {
        "world": WORLD,
        "seed": seed,
        "episodes": episodes,
        "duration_s": duration_s or 0.0,
        "traits": ",".join(traits),
        "only": ",".join(only),
        **{f"count_{k}": n for k, n in counts.items()},
    }
    if not (out / LABELS).exists():
        secret = salt or new_salt()
        rng = np.random.default_rng(secret_number(seed, secret, "random small scenes"))
        drawn = _draw(counts, rng, traits, only, episodes, duration_s, crew, told)
        write_once(out / LABELS, LabelsFile(salt=secret, asked=asked, labels={a.case: canonical(a) for a in drawn}))
    return standing_labels(out, asked, salt)


def _draw(
    counts: dict[Kind, int],
    rng: np.random.Generator,
    traits: Sequence[str],
    only: Sequence[str],
    episodes: int,
    duration_s: float | None,
    crew: Crew,
    told: Told,
) -> list[Label]:
    """Return the labels of a run in random order."""
    nulls, singles = counts.get("null", 0), counts.get("one", 0)
    kinds: list[tuple[str, str]] = [("", trait) for trait in null_traits(nulls, rng, traits)]
    causes = _turns(only or list(CAUSES), singles, rng)
    kinds += list(zip(causes, _turns(traits or ["plain"], singles, rng), strict=True))
    tasks = []
    for i, k in enumerate(rng.permutation(len(kinds)).tolist()):
        cause, trait = kinds[k]
        tasks.append((f"case-{i + 1:04d}", cause, trait, int(rng.integers(2**62)), episodes, duration_s))
    found = {}
    for label in crew(draw_label, tasks):
        found[label.case] = label
        told(label.case)
    return [found[name] for name in sorted(found)]


def null_traits(total: int, rng: np.random.Generator, traits: Sequence[str] = ()) -> list[str]:
    """Return the traits of nulls: those asked for in turns, or half plain and the other half in turns."""
    if traits:
        return _turns(traits, total, rng)
    plain = total - total // 2
    return ["plain"] * plain + _turns([t for t in all_traits() if t != "plain"], total - plain, rng)


def _turns(names: Sequence[str], count: int, rng: np.random.Generator) -> list[str]:
    """Return `count` names, each as often as the others but for one, the order of each round random."""
    rounds = [rng.permutation(list(names)) for _ in range(-(-count // len(names)))] if names else []
    return [str(name) for part in rounds for name in part][:count]


def draw_label(case: str, cause: str, trait: str, seed: int, episodes: int, duration_s: float | None) -> Label:
    """Return the label of a case: a null, or a cause that can act and matters in the scene that its seed draws.

    Where it does not, the next seed is taken. Runs in any process.
    """
    if not cause:
        return Label(case=case, kind="null", trait=trait, seed=seed)
    seed, effect = drawn_cause(cause, trait, seed, episodes, duration_s)
    return Label(case=case, kind="one", trait=trait, seed=seed, effects=(effect,))


def make_rig_cases(
    out: Path,
    sealed: LabelsFile,
    *,
    episodes: int,
    duration_s: float | None = None,
    crew: Crew = alone,
    told: Told = lambda name: None,
) -> list[Path]:
    """Return the folders of all cases, those that are missing made; `told` hears the name of each new one."""
    folder = (out / CASES).resolve()
    tasks = [
        (str(folder / name), text, commitment(text, sealed.salt), episodes, duration_s)
        for name, text in missing_cases(out, sealed).items()
    ]
    for name in crew(make_rig_case, tasks):
        told(name)
    return [out / CASES / name for name in sealed.labels]


def make_rig_case(folder: str, text: str, sealed: str, episodes: int, duration_s: float | None) -> str:
    """Return the name of a case after its folder was written, whole or not at all.

    Parameters
    ----------
    folder : str
        Where the case goes.
    text, sealed : str
        The label as canonical JSON, and its commitment.
    episodes : int
    duration_s : float, optional
        Length of an episode; the scene's own by default.
    """
    path = Path(folder)
    write_rig_case(path, Label.parse(parse_json(text), path), sealed, episodes, duration_s)
    return path.name


def write_rig_case(path: Path, label: Label, sealed: str, number: int, duration_s: float | None = None) -> Drawn:
    """Return the scene of a label after writing its case into a folder."""
    drawn = sane_rig(label.seed, label.trait or "plain", number, duration_s)
    rig = drawn.rig
    world = planted(rig, label.effects[0]) if label.effects else Planted(nominal(rig), ideal)
    played = logs(world.world, rig, drawn.outlines) if label.effects else drawn.logs
    if played is None:
        raise RuntimeError(f"the world of {label.case} does not come to rest")
    rng = np.random.default_rng([label.seed, NOISE_STREAM])
    read = [
        noisy(rig, episode_reading(world, log, one.lead), rng) for log, one in zip(played, drawn.outlines, strict=True)
    ]
    shutil.rmtree(path, ignore_errors=True)
    case = CaseFile(name=path.name, scene="scene.yaml", episodes=number, sealed=sealed)
    with draft_beside(path) as drafts:
        draft = drafts / path.name
        create_dataset(draft, path.name)
        append(draft, episodes(rig, drawn.outlines, read), Lineage(operation="blind case", sealed=sealed))
        (draft / "scene.xml").write_text(rig.xml + "\n")
        vouch(draft / "scene.xml")
        (draft / "scene.yaml").write_text(rig.yaml)
        (draft / CASE).write_text(case.model_dump_json(indent=1) + "\n")
        place(draft, path)
    return drawn
