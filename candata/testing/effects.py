"""What every effect keeps: words, ranges, a neutral value that changes nothing, others that do, and clear errors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from string import Formatter
from typing import ClassVar, get_args

import numpy as np
from numpy.typing import NDArray

from candata.effects import EFFECTS, Effect, Parameter, Trait, flatten, setting
from candata.errors import UsageError
from candata.policies import policy
from candata.scenes import Scene, load_scene
from candata.schema.effect import EffectSetting
from candata.simulate import rollout
from candata.simulate.jobs import possible_policies
from candata.simulate.seal import draw_parameter
from candata.simulate.world import build_worlds
from candata.testing._claims import refusal_of, registered_name, require, require_words
from candata.units import TO_SI

Readings = dict[str, NDArray[np.float64]]
PLACES = ("joint", "link", "fingertip", "object", "wrist", "world")
#: What the words of an effect may name, and what MJCF's may.
PLACEHOLDERS, MJCF_PLACEHOLDERS = {"x", "joint", "servo", "link", "tip", "surface"}, {"raw"}
#: The motion that touches most, where a scene has it.
GRASP = "grasp_lift_shake"
#: What is left of the supply at the end of a motion. Chosen: a bus of servos under load sags by tens of per cent.
SAGGED = 0.7


def sagging_supply(commands: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a supply over its usual value for commands `(n, T, A)`, as recorded: it falls from 1 to `SAGGED`."""
    return np.broadcast_to(np.linspace(1, SAGGED, commands.shape[1])[:, None], commands.shape)


class EffectConformance:
    """Conformance of one effect.

    Attributes
    ----------
    effect : Effect
        The constant of the plug-in.
    scenes : tuple of str, Path or Scene
        Scenes, by name, path or loaded; the effect is played in each in which it can act, and must be able to in one.
    duration_s : float
        How long a motion is played: enough to grasp and lift.
    """

    effect: ClassVar[Effect]
    scenes: ClassVar[tuple[str | Path | Scene, ...]] = ("gripper_tabletop", "cube_toss")
    duration_s: ClassVar[float] = 1.4

    def play(self, scene: Scene, worlds: Sequence[Sequence[EffectSetting]]) -> Readings:
        """Return what n worlds read while they play one motion; to be replaced where a scene needs one of its own."""
        motions = possible_policies(scene)
        name = GRASP if GRASP in motions else motions[0]
        plan = policy(name).plan(scene, np.random.default_rng(5), self.duration_s)
        commands, qpos, qvel = (np.repeat(a[None], len(worlds), axis=0) for a in (plan.commands, plan.qpos, plan.qvel))
        return dict(rollout(scene, commands, qpos, qvel, worlds, supply=sagging_supply(commands)).readings)

    def test_it_is_registered_and_in_words(self) -> None:
        """Users come to it by its name, and read what it is."""
        require_words(EFFECTS, self.effect)
        require(self.effect.acts_on in PLACES, f"acts_on is {self.effect.acts_on!r}, not one of {', '.join(PLACES)}")
        unknown_traits = self.effect.traits - set(get_args(Trait))
        require(not unknown_traits, f"no such traits: {', '.join(sorted(unknown_traits))}")
        advice = self.effect.advice
        if self.effect.fitted or advice is None:
            require(self.effect.fitted, "`advice` is missing: what a report tells people to change")
            return
        for text, allowed in ((advice.change, PLACEHOLDERS), (advice.mjcf, MJCF_PLACEHOLDERS)):
            placeholders = {field for _, field, _, _ in Formatter().parse(text) if field is not None}
            require(placeholders <= allowed, f"advice {text!r} names {placeholders - allowed}; there are {allowed}")
            require(not text.endswith("."), f"advice {text!r} ends in a full stop")
        require("{x}" in advice.change, "`advice.change` does not say the value, {x}")

    def test_its_parameters_have_units_ranges_and_a_source(self) -> None:
        """Bounds, probes and draws are finite in any scene, also where it cannot act, and lie within the bounds."""
        require(self.effect.parameters, "there are no parameters")
        for p in self.effect.parameters:
            require(p.unit in TO_SI, f"{p.name}: unit {p.unit!r} is not in candata.units")
            require(p.source, f"{p.name}: `source` does not say where its ranges come from")
            for scene in self._scenes():
                _require_ranges(p, scene, self.effect.possible(scene))

    def test_it_can_act_in_one_of_the_scenes(self) -> None:
        """Else nothing below would say anything."""
        names = ", ".join(scene.name for scene in self._scenes())
        require(self._possible_scenes(), f"it can act in none of {names}: name another in `scenes`")

    def test_the_neutral_value_changes_nothing_bit_for_bit(self) -> None:
        """Not named, or named at its identity, an effect is not there."""
        for scene in self._possible_scenes():
            readings = self._neutral_readings(scene)
            for channel, values in readings.items():
                is_same = all(np.array_equal(row, values[0]) for row in values[1:])
                require(is_same, f"scene {scene.name}: the neutral value moves {channel}")

    def test_every_other_value_moves_a_channel_and_stays_finite(self) -> None:
        """A probe that moves nothing teaches nothing; one that gives NaN ends a diagnosis."""
        if self.effect.fitted:
            return
        for scene in self._possible_scenes():
            probes, readings = self._probe_readings(scene)
            for row, probe in enumerate(probes, start=1):
                place = f"scene {scene.name}: {probe.model_dump_json()}"
                require(_channels_moved(readings, row), f"{place} moves nothing")
                require(all(np.isfinite(v[row]).all() for v in readings.values()), f"{place} reads what is not finite")

    def test_a_filter_of_readings_moves_only_what_it_says(self) -> None:
        """`moves` is what a diagnosis looks at."""
        moves = set(self.effect.moves)
        require(
            bool(moves) == (self.effect.reading is not None), "`moves` names channels where there is a reading hook"
        )
        for scene in self._possible_scenes() if moves and not self.effect.fitted else ():
            probes, readings = self._probe_readings(scene)
            channels_moved = set().union(*(_channels_moved(readings, row + 1) for row in range(len(probes))))
            require(
                channels_moved <= moves,
                f"scene {scene.name}: it moves {', '.join(sorted(channels_moved - moves))}, not in `moves`",
            )

    def test_a_world_repeats_and_does_not_see_its_neighbours(self) -> None:
        """The same world gives the same bits, alone or among others."""
        if self.effect.fitted:
            return
        for scene in self._possible_scenes():
            probes, readings = self._probe_readings(scene)
            readings_alone = self.play(scene, [(probes[-1],)])
            for channel, values in readings_alone.items():
                require(
                    np.array_equal(values[0], readings[channel][-1]), f"scene {scene.name}: {channel} differs alone"
                )

    def test_a_setting_comes_back_through_json(self) -> None:
        """Settings and vectors are two views of one thing, and files hold them."""
        name = registered_name(EFFECTS, self.effect)
        for scene in self._possible_scenes() if not self.effect.fitted else ():
            x = np.concatenate([draw_parameter(p, scene, np.random.default_rng(3)) for p in self.effect.parameters])
            effect_setting = setting(name, x, scene)
            require(np.array_equal(flatten(effect_setting, scene), x), "a setting does not give back its vector")
            read_back = EffectSetting.model_validate_json(effect_setting.model_dump_json())
            require(read_back == effect_setting, "a setting does not come back through JSON")

    def test_bad_parameters_are_refused(self) -> None:
        """Out of bounds, no number, no such parameter: an error that says what was expected."""
        name = registered_name(EFFECTS, self.effect)
        for scene in self._possible_scenes():
            bad_settings = [EffectSetting(name=name, parameters={"no_such_parameter": 1.0})]
            bad_settings += [
                bad_setting for p in self.effect.parameters for bad_setting in _out_of_bounds(name, p, scene)
            ]
            for bad_setting in bad_settings:
                error = refusal_of(partial(flatten, bad_setting, scene), bad_setting.model_dump_json())
                require(
                    isinstance(error, UsageError),
                    f"{bad_setting.model_dump_json()} is refused as {type(error).__name__}",
                )

    def test_it_is_refused_where_it_cannot_act(self) -> None:
        """And each of its elements can be built where it can."""
        name = registered_name(EFFECTS, self.effect)
        for scene in self._scenes():
            if not self.effect.possible(scene):
                refusal_of(partial(build_worlds, scene, [(EffectSetting(name=name),)]), f"scene {scene.name}")
                continue
            build_worlds(scene, [(EffectSetting(name=name, element=e),) for e in self.effect.elements(scene)])

    @classmethod
    def _scenes(cls) -> list[Scene]:
        """Return the scenes of the suite."""
        return [_scene(name) for name in cls.scenes]

    @classmethod
    def _possible_scenes(cls) -> list[Scene]:
        """Return the scenes in which the effect can act."""
        return [scene for scene in cls._scenes() if cls.effect.possible(scene)]

    @classmethod
    @cache
    def _probe_readings(cls, scene: Scene) -> tuple[list[EffectSetting], Readings]:
        """Return a setting a probe value and component, and the readings of the nominal world and of these, in rows."""
        probes = list(_probes(registered_name(EFFECTS, cls.effect), cls.effect, scene))
        return probes, cls().play(scene, [(), *((probe,) for probe in probes)])

    @classmethod
    @cache
    def _neutral_readings(cls, scene: Scene) -> Readings:
        """Return the readings of the nominal world, and of those with the effect at its identity."""
        name = registered_name(EFFECTS, cls.effect)
        x = flatten(EffectSetting(name=name), scene)
        neutral_settings = [EffectSetting(name=name)]
        neutral_settings += [setting(name, x, scene)] if np.isfinite(x).all() else []
        return cls().play(scene, [(), *((neutral_setting,) for neutral_setting in neutral_settings)])


@cache
def _scene(scene: str | Path | Scene) -> Scene:
    """Return a scene, compiled once."""
    return scene if isinstance(scene, Scene) else load_scene(scene)


def _require_ranges(p: Parameter, scene: Scene, can_act: bool) -> None:
    """Claim that what a parameter says of a scene is finite, and within the bounds where the effect can act."""
    place = f"{p.name} in scene {scene.name}"
    identity, (low, high) = p.identity(scene), p.bounds(scene)
    require((p.neutral is None) == np.isfinite(identity), f"{place}: give either `identity` or `neutral`")
    neutral = p.neutral(scene) if p.neutral else identity
    ranges: dict[str, Sequence[float]] = {
        "neutral": [neutral],
        "probes": p.probes(scene),
        "draws": list(np.ravel(p.draws(scene))),
    }
    for quantity, values in ({"bounds": [low, high]} | ranges).items():
        require(np.isfinite(values).all(), f"{place}: {quantity} are not finite: {values}")
    if not can_act:
        return
    require(low < high, f"{place}: the bounds are empty: {low:g} to {high:g}")
    for quantity, values in ranges.items():
        is_inside = (low <= np.asarray(values)) & (np.asarray(values) <= high)
        require(is_inside.all(), f"{place}: {quantity} leave the bounds {low:g} to {high:g}: {values}")
    require(neutral not in list(p.probes(scene)), f"{place}: a probe is the neutral value")


def _probes(name: str, effect: Effect, scene: Scene) -> Iterator[EffectSetting]:
    """Yield one setting a probe value and component, the others at the identity."""
    start = 0
    for p in effect.parameters:
        for component in range(p.size(scene)):
            for value in p.probes(scene):
                x = flatten(EffectSetting(name=name), scene)
                x[start + component] = value
                yield setting(name, x, scene)
        start += p.size(scene)


def _channels_moved(readings: Readings, row: int) -> set[str]:
    """Return the channels in which a row differs from the first."""
    return {channel for channel, values in readings.items() if not np.array_equal(values[row], values[0])}


def _out_of_bounds(name: str, p: Parameter, scene: Scene) -> Iterator[EffectSetting]:
    """Yield settings with a parameter below and above its bounds, as NaN, of a wrong size, or as an unknown word."""
    (low, high), size = p.bounds(scene), p.size(scene)
    if p.choices:
        yield EffectSetting(name=name, parameters={p.name: "no such word"})
        return
    for value in (low - 1e-3 * (high - low), high + 1e-3 * (high - low), float("nan")):
        yield EffectSetting(name=name, parameters={p.name: (value,) * size if size > 1 else value})
    yield EffectSetting(name=name, parameters={p.name: (low,) * (size + 1)})
