"""The simulator that a run's model reads: stated when it trains, made again when it forecasts."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from candata.errors import UsageError, Where
from candata.loaders import MixedWindows, Windows
from candata.models import model as find_model
from candata.scenes.assemble import OBJECT_MARK
from candata.schema.effect import EffectSetting
from candata.training.checkpoint import Checkpoint
from candata.training.episode_scenes import episode_scenes
from candata.training.processes import Processes
from candata.training.settings import Run, RunSimulator
from candata.training.simulated import Progress, SimulatedWindows, simulated_windows
from candata.training.simulator import Simulator, simulator


def stated(
    name: str,
    scene: str | None,
    effects: tuple[EffectSetting, ...] | None,
    initial: Checkpoint | None,
    train: Windows | MixedWindows,
) -> RunSimulator | None:
    """Return the simulator of a model that needs one, once it is known that it fits the data; None of another.

    Parameters
    ----------
    name : str
        Name of the model.
    scene : str or None
        What `load_scene` takes; that of `initial`, else the scene that each episode names.
    effects : tuple of EffectSetting or None
        Its effects; those of `initial`, else none.
    initial : Checkpoint or None
        What the run begins with.
    train : Windows or MixedWindows
        What is trained on.

    Raises
    ------
    UsageError
        When effects are given to a model that reads no simulator.
    CandataError
        As `candata.training.episode_scenes.episode_scenes`.
    """
    earlier = None if initial is None else initial.run.simulator
    if not find_model(name).needs_simulator:
        if effects is not None:
            raise UsageError(
                f"{name} reads no simulator",
                expected="a model that does, such as sim_residual",
                found="effects to simulate with",
                fix="leave --effects out",
            )
        return None
    scene = scene or (earlier.scene if earlier else None)
    if effects is None:
        effects = earlier.effects if earlier else ()
    sources = train.sources if isinstance(train, MixedWindows) else (train,)
    digests: dict[str, str] = {}
    for source in sources:
        digests |= episode_scenes(source, scene, effects).digests
    return RunSimulator(scene=scene, effects=effects, digests=digests)


def simulated_feed(
    windows: Windows | MixedWindows, run: Run, processes: Processes, simulating: Progress, folder: Path | None = None
) -> Windows | MixedWindows | SimulatedWindows:
    """Return the windows with the forecasts of the run's simulator, where it has one; kept in a folder."""
    facts = run.simulator
    if facts is None:
        return windows
    build = partial(simulator, scene=facts.scene, effects=facts.effects)
    return simulated_windows(windows, build, simulating, folder, first_share=processes.rank / processes.world)


def trained_simulator(
    source: Checkpoint, windows: Windows, scene: str | None = None, threads: int = 1
) -> Simulator | None:
    """Return the simulator that a trained model reads, for some windows; None for a model that reads none.

    Parameters
    ----------
    source : Checkpoint
        Of the run.
    windows : Windows
        What is to be forecast.
    scene : str, optional
        Where the scene lies now; that of the run by default.
    threads : int
        Threads of the stepping loop.

    Raises
    ------
    UsageError
        When a scene is not the one that the model was trained with, or there is none. One with an object of another
        name is taken, see `unmet_objects`.
    CandataError
        As `candata.training.simulator.simulator`.
    """
    facts = source.run.simulator
    if facts is None:
        return None
    made = simulator(windows, scene or facts.scene, facts.effects, threads=threads)
    trained_digests = set(facts.digests.values())
    trained_objects = {_object_name(name) for name in facts.digests}
    for name, digest in made.scenes.digests.items():
        is_other_object = OBJECT_MARK in name and _object_name(name) not in trained_objects
        if digest not in trained_digests and not is_other_object:
            raise UsageError(
                f"scene {name} is not the one that the model was trained in",
                expected=f"digest {' or '.join(sorted(each[:12] for each in trained_digests))}",
                found=f"digest {digest[:12]}",
                where=Where(path=str(source.path)),
                fix="bring the scene of that time back, or train again",
            )
    return made


def unmet_objects(run: Run, made: Simulator) -> tuple[str, ...]:
    """Return the names of objects in a model's simulator that were in none of the scenes it was trained in last."""
    trained_digests = set() if run.simulator is None else set(run.simulator.digests.values())
    return tuple(_object_name(name) for name, digest in made.scenes.digests.items() if digest not in trained_digests)


def _object_name(scene: str) -> str:
    """Return the name of the object that a scene holds in the place of its own, wherever its folder lies."""
    return Path(scene.partition(OBJECT_MARK)[2]).name
