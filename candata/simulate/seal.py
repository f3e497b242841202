"""Withheld effects: drawn from a seed and a secret salt, kept in a sealed file apart from the dataset."""

from __future__ import annotations

import hashlib
import json
import os
import secrets
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.datasets import Dataset
from candata.datasets.drafts import draft_beside
from candata.datasets.durable import encode_record, replace_synced, sync
from candata.datasets.writing import refused
from candata.effects import Parameter, effect, effect_names, setting
from candata.errors import DataError, UsageError, Where
from candata.scenes import Scene
from candata.schema.effect import EffectSetting, EffectsFile
from candata.schema.json_text import parse_json, read_json
from candata.schema.randomisation import RandomisationFile
from candata.schema.record import Record
from candata.schema.text_bounds import TextError
from candata.simulate.randomisation import check_randomisation, drawn_effects

ANY_EFFECT = "any"
#: What may be withheld: an effect by name, or any; or all that is drawn of a randomisation.
Asked = str | RandomisationFile
SALT_BYTES = 32
#: Rights of a sealed file: its owner reads and writes it.
_OWNER_ALONE = 0o600


class Seal(Record):
    """The sealed file: what was withheld and how it was drawn.

    `asked` is the effect that was asked for, or `any`, or `randomisation` and the sha256 of one; `label` is the
    canonical JSON of the effect's setting, or of an `effects.yaml` with all that was drawn of a randomisation; `sealed`
    is the commitment sha256(label + salt) that the dataset's lineage carries.
    """

    scene_digest: str
    asked: str
    seed: int
    salt: str
    label: str
    sealed: str

    @property
    def effects(self) -> tuple[EffectSetting, ...]:
        """The settings that were withheld.

        Raises
        ------
        UsageError
            When the label is not what was written.
        """
        try:
            value = parse_json(self.label)
        except TextError as error:
            raise UsageError("the sealed label is damaged", expected="JSON", found=str(error)) from None
        if isinstance(value, dict) and "effects" in value:
            return EffectsFile.parse(value, "label").effects
        return (EffectSetting.parse(value, "label"),)

    @property
    def stream(self) -> int:
        """Seed of the set's episodes: not to be guessed from the small seed alone."""
        return secret_number(self.seed, self.salt, "episodes")


def new_salt() -> str:
    """Return 32 random bytes as hex."""
    return secrets.token_hex(SALT_BYTES)


def draw(scene: Scene, asked: Asked, seed: int, salt: str) -> Seal:
    """Return the sealed draw of an effect, of any that can act in the scene, or of a randomisation.

    Parameters
    ----------
    scene : Scene
        Where it acts.
    asked : str or RandomisationFile
        Name of the effect, or `any`: each possible one is as likely. Of a randomisation, one draw for the whole set.
    seed : int
        The set's seed.
    salt : str
        Secret, hex of 32 bytes; seed and salt together decide the draw.

    Raises
    ------
    UnknownNameError
        When there is no such effect.
    UsageError
        When it cannot act in the scene, follows what is recorded, or the salt is no hex of 32 bytes; or when a
        randomisation cannot be drawn.
    """
    if isinstance(asked, str):
        label = canonical(_drawn_effect(scene, asked, seed, salt))
    else:
        check_randomisation(asked.effects, scene)
        secret_seed = secret_number(seed, salt, "randomisation")
        effects = drawn_effects(asked.effects, scene, secret_seed, 0, asked.together)
        label = canonical(EffectsFile(effects=effects))
    return Seal(
        scene_digest=scene.digest,
        asked=_asked_text(asked),
        seed=seed,
        salt=salt,
        label=label,
        sealed=commitment(label, salt),
    )


def _asked_text(asked: Asked) -> str:
    """Return what a seal says of what was asked for."""
    if isinstance(asked, str):
        return asked
    drawn_from = RandomisationFile(effects=asked.effects, together=asked.together)
    return f"randomisation {hashlib.sha256(canonical(drawn_from).encode()).hexdigest()}"


def _drawn_effect(scene: Scene, effect_name: str, seed: int, salt: str) -> EffectSetting:
    """Return a draw of one effect, or of any."""
    rng = np.random.default_rng(secret_number(seed, salt, "effect"))
    possible_effects = [drawn_name for drawn_name in effect_names() if effect(drawn_name).possible(scene)]
    if effect_name != ANY_EFFECT and (effect(effect_name).follows or not effect(effect_name).possible(scene)):
        raise UsageError(
            f"effect {effect_name} cannot act in scene {scene.name}",
            expected=f"one of {', '.join(possible_effects)}",
            found=effect_name,
        )
    drawn_name = str(rng.choice(possible_effects)) if effect_name == ANY_EFFECT else effect_name
    values = np.concatenate([draw_parameter(p, scene, rng) for p in effect(drawn_name).parameters])
    return setting(drawn_name, values, scene)


def draw_parameter(parameter: Parameter, scene: Scene, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return `(size,)` values from the parameter's drawing intervals, each interval as likely.

    Of a vector at least one component lies farther from the identity than half of the farthest possible.
    """
    spans, size = np.array(parameter.draws(scene), float), parameter.size(scene)
    identity = np.nan_to_num(parameter.identity(scene))
    least_distance = 0.5 * np.abs(spans - identity).max() if size > 1 else 0.0
    while True:
        low, high = spans[rng.integers(len(spans), size=size)].T
        values = low + rng.random(size) * (high - low)
        if np.abs(values - identity).max() >= least_distance:
            return values


def commitment(label: str, salt: str) -> str:
    """Return sha256(label + salt) as hex: binds the set to its label and tells nothing of it."""
    return hashlib.sha256(label.encode() + _salt_bytes(salt)).hexdigest()


def keep(path: Path, scene: Scene, asked: Asked, seed: int, salt: str | None) -> Seal:
    """Return the seal that stands in `path`; a fresh one, written and synced first, where none does.

    Parameters
    ----------
    path : Path
        The sealed file; made readable for its owner only.
    scene, asked, seed
        As in `draw`; a seal that stands must have been drawn for the same.
    salt : str, optional
        Secret of a fresh draw; random by default.

    Raises
    ------
    UsageError
        When the file belongs to another set or is no sealed file.
    """
    if not path.exists():
        new_seal = draw(scene, asked, seed, salt or new_salt())
        write_once(path, new_seal)
    seal = read_seal(path)
    expected_fields = {
        "scene_digest": scene.digest,
        "asked": _asked_text(asked),
        "seed": seed,
        "salt": salt or seal.salt,
    }
    for name, value in expected_fields.items():
        if getattr(seal, name) != value:
            raise UsageError(
                f"the sealed file belongs to another set: its {name.split('_')[0]} differs",
                where=Where(path=str(path)),
                fix="give another --seal and --out, or repeat the first command",
            )
    return seal


def read_seal(path: Path) -> Seal:
    """Return the record of a sealed file.

    Raises
    ------
    UsageError
        When the file is missing or no sealed file.
    """
    if not path.is_file():
        raise UsageError("no sealed file", expected="what --withhold wrote", where=Where(path=str(path)))
    return Seal.parse(read_json(path), path)


def open_seal(path: str | Path, dataset: Dataset) -> tuple[EffectSetting, ...]:
    """Return the effects that were withheld from `dataset`, the commitment verified: one unless a file was drawn from.

    Parameters
    ----------
    path : str or Path
        The sealed file.
    dataset : Dataset
        The set whose lineage carries the commitment.

    Raises
    ------
    UsageError
        When the file is missing or no sealed file.
    DataError
        When the seal was tampered with, or belongs to another dataset.
    """
    seal = read_seal(Path(path))
    own_commitment = commitment(seal.label, seal.salt)
    commitments = [step.sealed for step in dataset.lineage if step.sealed]
    if own_commitment not in commitments:
        raise DataError(
            "the seal does not fit the dataset",
            expected=f"sealed {', '.join(k[:12] for k in commitments) or '-'}",
            found=f"sealed {own_commitment[:12]}",
            where=Where(path=str(path)),
            fix="give the sealed file that was written beside this dataset",
        )
    return seal.effects


def canonical(record: Record) -> str:
    """Return the record as JSON that two equal records share."""
    return json.dumps(record.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))


def _salt_bytes(salt: str) -> bytes:
    """Return the bytes of a salt."""
    try:
        secret = bytes.fromhex(salt)
    except ValueError:
        secret = b""
    if len(secret) != SALT_BYTES:
        raise UsageError("not a salt", expected=f"{2 * SALT_BYTES} hex digits", found=f"{len(salt)} others")
    return secret


def secret_number(seed: int, salt: str, purpose: str) -> int:
    """Return 128 bits of sha256(purpose, seed, salt): not to be guessed from the small seed alone."""
    text = f"{purpose}|{seed}|".encode() + _salt_bytes(salt)
    return int.from_bytes(hashlib.sha256(text).digest()[:16], "little")


def write_once(path: Path, seal: Record) -> None:
    """Write the sealed file whole, for its owner alone; who came first wins.

    Raises
    ------
    SetupError
        When it cannot be written.
    """
    with refused(path, "seal"), draft_beside(path) as folder:
        draft = folder / path.name
        draft.touch(_OWNER_ALONE)
        draft.write_bytes(encode_record(seal))
        sync(draft)
        _link(draft, path)
        sync(path.parent)


def _link(draft: Path, path: Path) -> None:
    """Give the draft its name unless the name is taken; replace where the disk has no hard links."""
    try:
        os.link(draft, path)
    except FileExistsError:
        return
    except OSError:
        replace_synced(draft, path)
