"""Effects drawn for each episode of a set: whether each is there, and its numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from candata.effects import Parameter, acts_on_element, parameters_on
from candata.errors import UnknownNameError, UsageError
from candata.scenes import Scene
from candata.schema.effect import EffectSetting, Value
from candata.schema.randomisation import Distribution, RandomEffect
from candata.simulate.episodes import EFFECT_STREAM
from candata.simulate.world import build_worlds

#: Draws of a normal distribution, all outside the range of the effect, after which that is an error. Chosen.
MOST_DRAWS = 1000


def drawn_effects(
    randomisation: Sequence[RandomEffect],
    scene: Scene,
    seed: int,
    index: int,
    together: tuple[int, int] | None = None,
) -> tuple[EffectSetting, ...]:
    """Return the effects of one episode, in the order of the randomisation.

    Seed, index and an effect's place in the list decide its draw: an effect that is added at the end changes no other.

    Parameters
    ----------
    randomisation : sequence of RandomEffect
        Checked by `check_randomisation`.
    scene : Scene
        Where the episode plays: its ranges cut normal distributions.
    seed, index : int
        Seed of the set, and number of the episode.
    together : (int, int), optional
        Fewest and most effects that act at once; each effect by its own share without it.

    Raises
    ------
    UsageError
        When no draw of a normal distribution lies in the range of its effect.
    """
    effects = []
    places = _drawn_places(len(randomisation), together, np.random.default_rng([seed, index, EFFECT_STREAM]))
    for place, random_effect in enumerate(randomisation):
        rng = np.random.default_rng([seed, index, EFFECT_STREAM, place])
        if rng.random() < random_effect.share and place in places:
            effects.append(_drawn_setting(random_effect, scene, rng))
    return tuple(effects)


def _drawn_places(count: int, together: tuple[int, int] | None, rng: np.random.Generator) -> frozenset[int]:
    """Return the places of the effects that may act: all, or as many as may act together."""
    if together is None:
        return frozenset(range(count))
    number = int(rng.integers(together[0], together[1] + 1))
    return frozenset(int(place) for place in rng.permutation(count)[:number])


def check_randomisation(randomisation: Sequence[RandomEffect], scene: Scene) -> None:
    """Refuse what could be drawn and cannot be simulated in `scene`.

    Raises
    ------
    UnknownNameError
        When there is no such effect, element, parameter or word.
    UsageError
        When an effect cannot act in the scene, or a value that may be drawn lies outside its range.
    """
    for random_effect in randomisation:
        name, element = random_effect.name, random_effect.element
        build_worlds(scene, [[EffectSetting(name=name, element=element)]])
        by_name = {p.name: p for p in parameters_on(name, scene, element)}
        for parameter_name, source in random_effect.parameters.items():
            if parameter_name not in by_name:
                raise UnknownNameError(f"parameter of {name}:", parameter_name, by_name)
            for value in _outermost_values(source, by_name[parameter_name], scene, random_effect):
                setting = EffectSetting(name=name, element=element, parameters={parameter_name: value})
                build_worlds(scene, [[setting]])


def _drawn_setting(random_effect: RandomEffect, scene: Scene, rng: np.random.Generator) -> EffectSetting:
    """Return one effect with its numbers, drawn in the order of the effect's own parameters."""
    name, element = random_effect.name, random_effect.element
    parameters = {
        p.name: _drawn_value(random_effect.parameters[p.name], p, scene, random_effect, rng)
        for p in parameters_on(name, scene, element)
        if p.name in random_effect.parameters
    }
    return EffectSetting(name=name, element=element, parameters=parameters)


def _drawn_value(
    source: Value | Distribution,
    parameter: Parameter,
    scene: Scene,
    random_effect: RandomEffect,
    rng: np.random.Generator,
) -> Value:
    """Return a value of one parameter."""
    if not isinstance(source, Distribution):
        return source
    if source.choice is not None:
        return source.choice[int(rng.integers(len(source.choice)))]
    count = int(acts_on_element(parameter, scene, random_effect.element).sum())
    if source.uniform is not None:
        low, high = source.uniform
        return _as_value([low + share * (high - low) for share in rng.random(count)])
    return _as_value([_normal_number(source, parameter, scene, random_effect, rng) for _ in range(count)])


def _normal_number(
    source: Distribution, parameter: Parameter, scene: Scene, random_effect: RandomEffect, rng: np.random.Generator
) -> float:
    """Return a number of a normal distribution that lies in the range of the effect."""
    mean, deviation = source.normal or (np.nan, np.nan)
    low, high = parameter.bounds(scene)
    for _ in range(MOST_DRAWS):
        number = rng.normal(mean, deviation)
        if low <= number <= high:
            return float(number)
    raise UsageError(
        f"{random_effect.name}: no draw of {parameter.name} is possible in scene {scene.name}",
        expected=f"numbers in [{low:g}, {high:g}] {parameter.unit}",
        found=f"{MOST_DRAWS:,} draws outside, of normal: [{mean:g}, {deviation:g}]",
        fix="move the mean into the range",
    )


def _outermost_values(
    source: Value | Distribution, parameter: Parameter, scene: Scene, random_effect: RandomEffect
) -> tuple[Value, ...]:
    """Return values that are all possible only if every draw is; of a normal distribution one that is kept."""
    if not isinstance(source, Distribution):
        return (source,)
    if source.choice is not None:
        return source.choice
    if parameter.choices:
        raise UsageError(
            f"{random_effect.name}: {parameter.name} is a word",
            expected=f"choice: [{', '.join(parameter.choices)}]",
            found="uniform" if source.uniform is not None else "normal",
        )
    numbers = source.uniform or (float(np.clip((source.normal or (np.nan,))[0], *parameter.bounds(scene))),)
    count = int(acts_on_element(parameter, scene, random_effect.element).sum())
    return tuple(_as_value([number] * count) for number in numbers)


def _as_value(numbers: Sequence[float]) -> Value:
    """Return one number as it is, several as a vector."""
    return float(numbers[0]) if len(numbers) == 1 else tuple(float(number) for number in numbers)
