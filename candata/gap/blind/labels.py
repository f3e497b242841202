"""Labels of blind cases: drawn and sealed in one file, opened when all is diagnosed."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from candata.errors import DataError, UsageError, Where
from candata.gap.blind.draws import draw_labels
from candata.scenes import Scene
from candata.schema.bench import CaseFile, Kind, Label, LabelsFile
from candata.schema.json_text import parse_json, read_json
from candata.simulate.seal import canonical, commitment, new_salt, secret_number, write_once

LABELS = "sealed.json"
#: Salt of cases that are kept to train on: no secret, so that the same command draws the same cases anywhere.
TRAINING_SALT = hashlib.sha256(b"candata training bench").hexdigest()


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
    return LabelsFile.parse(parsed(path), path)


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


def parsed(path: Path) -> object:
    """Return the content of a JSON file."""
    if not path.is_file():
        raise UsageError(f"no file {path.name}", where=Where(path=str(path)))
    return read_json(path)
