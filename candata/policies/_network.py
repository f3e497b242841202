"""A multilayer perceptron as a policy: weights in a safetensors file, a JSON card beside it."""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from candata.errors import DataError, MissingExtraError, UsageError, Where
from candata.lfs import refuse_pointer
from candata.policies._contract import Array, Observation, Step
from candata.scenes import Scene
from candata.schema.json_text import read_json
from candata.schema.policy_card import PolicyCard

#: How the name of a network's file ends.
SUFFIX = ".safetensors"


def _silu(x: Array) -> Array:
    """Return x times its logistic function (Elfwing, Uchibe & Doya 2018)."""
    return x / (1 + np.exp(-np.clip(x, -500, 500)))


def _elu(x: Array) -> Array:
    """Return x, below zero exp(x) - 1 (Clevert, Unterthiner & Hochreiter 2016)."""
    return np.where(x > 0, x, np.expm1(np.minimum(x, 0)))


_ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "relu": lambda x: np.maximum(x, 0),
    "tanh": np.tanh,
    "silu": _silu,
    "elu": _elu,
}


@dataclass(frozen=True)
class Network:
    """A multilayer perceptron.

    Attributes
    ----------
    card : PolicyCard
        What goes in and comes out.
    layers : tuple of (weight (O, I), bias (O,)) float64
    input_mean, input_scale, output_mean, output_scale : ndarray or float
        Inputs are taken less their mean and over their scale; outputs are multiplied and shifted back.
    path : Path
        Where it came from, for errors.
    """

    card: PolicyCard
    layers: tuple[tuple[Array, Array], ...]
    input_mean: Array | float
    input_scale: Array | float
    output_mean: Array | float
    output_scale: Array | float
    path: Path

    def begin(self, scene: Scene) -> Step:
        """Return `step(observation) -> (A,)` for one episode.

        Raises
        ------
        DataError
            When the network was made for another scene, or its sizes are not those of this one.
        """
        self._refuse_other(scene)
        history: deque[Array] = deque(maxlen=self.card.history)
        last_finite: dict[str, Array] = {}

        def step(observation: Observation) -> Array:
            seen = {**observation.readings, "action": observation.action}
            for name in self.card.inputs:  # a reading that is missing keeps its last value; 0 before the first
                values = np.ravel(seen[name])
                last_finite[name] = np.where(np.isfinite(values), values, last_finite.get(name, 0.0))
            now = np.concatenate([last_finite[name] for name in self.card.inputs])
            history.extend([now] * (1 if history else self.card.history))
            out = self._forward(np.concatenate(history))
            return out + observation.action if self.card.commands == "change" else out

        return step

    def hidden(self, values: Array) -> Array:
        """Return what the last layer takes `(..., O)` of inputs `(..., I)`."""
        values = (values - self.input_mean) / self.input_scale
        for weight, bias in self.layers[:-1]:
            values = _ACTIVATIONS[self.card.activation](values @ weight.T + bias)
        return values

    def _forward(self, values: Array) -> Array:
        """Return the output of one input."""
        weight, bias = self.layers[-1]
        return (weight @ self.hidden(values) + bias) * self.output_scale + self.output_mean

    def _refuse_other(self, scene: Scene) -> None:
        """Refuse a scene of another digest, or of other sizes."""
        if self.card.scene_digest is not None and self.card.scene_digest != scene.digest:
            raise DataError(
                "the network was made for another scene",
                expected=f"a scene of digest {self.card.scene_digest[:12]}",
                found=f"{scene.name}, digest {scene.digest[:12]}",
                where=Where(path=str(self.path)),
            )
        sizes = {
            "object_pose": 7 if scene.object_id is not None else 0,
            "joint_position": len(scene.joint_qpos),
            "fingertip_force": 3 * len(scene.force_sensors),
            "action": len(scene.actuator_ids),
        }
        given = self.card.history * sum(sizes[name] for name in self.card.inputs)
        shape = (self.layers[0][0].shape[1], self.layers[-1][0].shape[0])
        if shape != (given, sizes["action"]):
            raise DataError(
                f"the network does not fit scene {scene.name}",
                expected=f"{given} inputs ({', '.join(self.card.inputs)}) and {sizes['action']} commands",
                found=f"{shape[0]} inputs and {shape[1]} outputs",
                where=Where(path=str(self.path)),
            )


def read_network(path: Path) -> tuple[Network, str]:
    """Return a network and the SHA-256 of its file and card.

    Raises
    ------
    UsageError
        When the file or its card is missing.
    DataError
        When one of them is not valid.
    MissingExtraError
        When safetensors is not installed.
    """
    try:
        from safetensors import SafetensorError
        from safetensors.numpy import load
    except ImportError:
        raise MissingExtraError("safetensors", "train") from None
    card_path = path.with_suffix(".json")
    for file in (path, card_path):
        if not file.is_file():
            raise UsageError(
                f"{file} does not exist",
                expected="a network FILE.safetensors and its card FILE.json beside it",
                where=Where(path=str(file)),
            )
    refuse_pointer(path)
    card, content = PolicyCard.parse(read_json(card_path), card_path), path.read_bytes()
    try:
        tensors = {name: np.asarray(value, float) for name, value in load(content).items()}
    except (SafetensorError, ValueError, TypeError, KeyError) as error:
        raise DataError("the network cannot be read", found=str(error), where=Where(path=str(path))) from None
    return _network(card, tensors, path), hashlib.sha256(content + card.model_dump_json().encode()).hexdigest()


def _network(card: PolicyCard, tensors: dict[str, Array], path: Path) -> Network:
    """Return the network of named arrays, once it is known that they fit together."""
    count = sum(name.startswith("layers.") and name.endswith(".weight") for name in tensors)
    names = {f"layers.{k}.{part}" for k in range(count) for part in ("weight", "bias")}
    optional = {"input_mean", "input_scale", "output_mean", "output_scale"}
    if not count or not names <= set(tensors) or set(tensors) - names - optional:
        raise _misfit("layers.0.weight, layers.0.bias, layers.1.weight, ...", ", ".join(sorted(tensors)), path)
    layers = tuple((tensors[f"layers.{k}.weight"], tensors[f"layers.{k}.bias"]) for k in range(count))
    for k, (weight, bias) in enumerate(layers):
        size = weight.shape[1] if k == 0 and weight.ndim == 2 else layers[k - 1][0].shape[0]
        if weight.ndim != 2 or weight.shape[1] != size or bias.shape != weight.shape[:1]:
            raise _misfit(f"layer {k} of {size} inputs and one bias an output", f"{weight.shape}, {bias.shape}", path)
    ends = {"input": layers[0][0].shape[1], "output": layers[-1][0].shape[0]}
    for name in optional & set(tensors):
        if tensors[name].shape != (ends[name.partition("_")[0]],):
            raise _misfit(f"{name} ({ends[name.partition('_')[0]]},)", str(tensors[name].shape), path)
    if not all(np.isfinite(value).all() for value in tensors.values()):
        raise _misfit("finite numbers", "others", path)
    if not np.all(tensors.get("input_scale", 1.0)):
        raise _misfit("input_scale other than 0", "0", path)
    defaults = {"input_mean": 0.0, "input_scale": 1.0, "output_mean": 0.0, "output_scale": 1.0}
    return Network(card, layers, **{name: tensors.get(name, default) for name, default in defaults.items()}, path=path)


def _misfit(expected: str, found: str, path: Path) -> DataError:
    """Return the error for arrays that make no network."""
    return DataError("the file holds no network", expected=expected, found=found, where=Where(path=str(path)))
