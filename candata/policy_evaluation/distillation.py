"""A network that does what refined chunks do: the last layer of a policy fitted anew, or a small one from nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.datasets.writing import replacing
from candata.errors import UsageError, Where
from candata.policies._network import Network
from candata.policy_evaluation.chunk_starts import ChunkStarts
from candata.scenes import Scene
from candata.schema.policy_card import PolicyCard
from candata.training.simulator import Simulator

Array = NDArray[np.float64]
#: Ridge of the last layer's change, as a share of the mean energy of its inputs. Chosen: directions that a thousandth
#: of the energy lies in are left as they were.
RIDGE_SHARE = 1e-3
#: Hidden layers, steps, rows a step and learning rate of a network from nothing. Chosen: the commands of a hand for 60
#: starts are fitted to a hundredth of their spread within seconds.
WIDTHS, STEPS, BATCH, LEARNING_RATE = (64, 64), 3000, 256, 2e-3
#: Control steps that a network from nothing sees. Chosen: how fast the object and the fingers move is among them.
HISTORY = 4
#: Least scale of an input or output, in its unit. Chosen: a tenth of a millimetre, and of a milliradian.
LEAST_SCALE = 1e-4


@dataclass(frozen=True, eq=False)
class ChunkRows:
    """What a policy would have seen and is to command, from the beginning of each episode to the end of its chunk.

    Attributes
    ----------
    readings : tuple of S mappings of str to ndarray
        `object_pose (T, 7)`, `joint_position (T, J)`, and `action (T, A)`, the commands of the row before.
    commands : tuple of S (T, A) float64
        What is to be commanded.
    """

    readings: tuple[Mapping[str, Array], ...]
    commands: tuple[Array, ...]

    def inputs(self, names: tuple[str, ...], history: int) -> Array:
        """Return what a network is given `(rows, I)`: `names` of the last rows, the oldest first, as a policy sees it.

        Raises
        ------
        UsageError
            When it reads what is not simulated here.
        """
        parts = []
        for reading in self.readings:
            missing = [name for name in names if name not in reading]
            if missing:
                raise UsageError(
                    "the policy reads what refined chunks do not hold",
                    expected=", ".join(reading),
                    found=", ".join(missing),
                    fix="refine a policy that reads poses, joints and commands",
                )
            now = np.concatenate([reading[name] for name in names], axis=1)
            rows = np.arange(len(now))[:, None] + np.arange(1 - history, 1)
            parts.append(now[rows.clip(0)].reshape(len(now), -1))
        return np.concatenate(parts)

    def targets(self, kind: str) -> Array:
        """Return what a network gives `(rows, A)`: the commands, or with `change` their change from the row before."""
        commands = np.concatenate(self.commands)
        return commands - np.concatenate([r["action"] for r in self.readings]) if kind == "change" else commands


def chunk_rows(starts: ChunkStarts, commands: Array, simulator: Simulator) -> ChunkRows:
    """Return the rows of chunks `(S, R, A)`: recorded up to each start, and simulated from there on.

    Parameters
    ----------
    starts : ChunkStarts
        At the episodes' own rate.
    commands : (S, R, A) float64
        Chunks.
    simulator : Simulator
        Of the windows of these starts.
    """
    windows, cache = starts.windows, starts.windows.cache
    played = simulator.simulate(starts.batch(commands[:, None]))
    readings, targets = [], []
    for start, episode in enumerate(windows.owner.tolist()):
        rows = cache.rows[cache.begin[episode] : windows.present_row[start] + 1]
        # The last reading of a chunk has no command after it.
        seen = {
            "object_pose": np.concatenate([rows["object_pose"], played.object_pose[start, :-1]]),
            "joint_position": np.concatenate([rows["joint_position"], played.joint_position[start, :-1]]),
        }
        target = np.concatenate([rows["action"][:-1], commands[start]]).astype(np.float64)
        readings.append({**seen, "action": np.concatenate([target[:1], target[:-1]])})
        targets.append(target)
    return ChunkRows(tuple(readings), tuple(targets))


def distilled_last_layer(network: Network, rows: ChunkRows) -> Network:
    """Return a network whose last layer is fitted to the rows by ridge regression about what it was.

    min |F W' - Y|^2 + r |W' - W|^2 with the outputs F of the layer before and r = `RIDGE_SHARE` of their energy.

    Raises
    ------
    UsageError
        When the network reads what the rows do not hold.
    """
    values = rows.inputs(network.card.inputs, network.card.history)
    hidden = network.hidden(values)
    features = np.c_[hidden, np.ones(len(hidden))]
    weight, bias = network.layers[-1]
    before = np.c_[weight, bias].T
    target = (rows.targets(network.card.commands) - network.output_mean) / network.output_scale
    gram = features.T @ features
    ridge = RIDGE_SHARE * np.trace(gram) / len(gram)
    change = np.linalg.solve(gram + ridge * np.eye(len(gram)), features.T @ (target - features @ before))
    after = (before + change).T
    return replace(network, layers=(*network.layers[:-1], (after[:, :-1], after[:, -1])))


def distilled_network(rows: ChunkRows, scene: Scene, seed: int, steps: int = STEPS) -> Network:
    """Return a small network trained on the rows: it gives the change of the commands.

    Parameters
    ----------
    rows : ChunkRows
        What it sees and is to do.
    scene : Scene
        The only one that it is for.
    seed : int
        Of the first weights and of the batches.
    steps : int
        Steps of the optimiser.
    """
    import torch

    card = PolicyCard(
        inputs=("object_pose", "joint_position", "action"),
        history=HISTORY,
        activation="tanh",
        commands="change",
        scene_digest=scene.digest,
    )
    inputs, targets = rows.inputs(card.inputs, card.history), rows.targets(card.commands)
    scales = [(x.mean(0), np.maximum(x.std(0), LEAST_SCALE)) for x in (inputs, targets)]
    x, y = (
        torch.tensor((values - mean) / scale, dtype=torch.float32)
        for values, (mean, scale) in zip((inputs, targets), scales, strict=True)
    )
    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        sizes = (x.shape[1], *WIDTHS, y.shape[1])
        layers = [torch.nn.Linear(a, b) for a, b in pairwise(sizes)]
    parts = [part for layer in layers for part in (layer, torch.nn.Tanh())]
    module = torch.nn.Sequential(*parts[:-1])
    optimiser = torch.optim.Adam(module.parameters(), lr=LEARNING_RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        batch = torch.randint(len(x), (min(BATCH, len(x)),), generator=generator)
        loss = ((module(x[batch]) - y[batch]) ** 2).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    weights = tuple((layer.weight.detach().double().numpy(), layer.bias.detach().double().numpy()) for layer in layers)
    return Network(card, weights, *scales[0], *scales[1], path=Path())


def write_network(path: Path, network: Network) -> Path:
    """Return the path of a network, written with its card beside it, each whole or not at all.

    Raises
    ------
    UsageError
        When the path does not end in `.safetensors`.
    SetupError
        When it cannot be written.
    """
    from safetensors.numpy import save

    if path.suffix != ".safetensors":
        raise UsageError("a network is a .safetensors file", found=path.name, where=Where(path=str(path)))
    arrays = {
        f"layers.{k}.{part}": np.ascontiguousarray(value, np.float32)
        for k, layer in enumerate(network.layers)
        for part, value in zip(("weight", "bias"), layer, strict=True)
    }
    for name in ("input_mean", "input_scale", "output_mean", "output_scale"):
        value = np.asarray(getattr(network, name), np.float32)
        if value.ndim:
            arrays[name] = value
    with replacing(path.with_suffix(".json"), "policy") as draft:
        draft.write_text(network.card.model_dump_json(indent=2) + "\n")
    with replacing(path, "policy") as draft:
        draft.write_bytes(save(arrays))
    return path
