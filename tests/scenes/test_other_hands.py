"""Hands of other people: they load, every effect that can act there does so, and the motions reach the object."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from candata.effects import effect, effect_names, flatten, setting
from candata.errors import SceneError
from candata.gap.blind.draws import weakened
from candata.policies import policy
from candata.scenes import Scene, load_scene
from candata.schema.effect import EffectSetting
from candata.simulate import rollout
from candata.simulate.episodes import EpisodeJob, make_episodes
from tests.policies.unknown_hands import JAWS, JAWS_ROLES, write

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
needs_wheel = pytest.mark.skipif(find_spec("gymnasium_robotics") is None, reason="gymnasium-robotics is not installed")
BOTH = pytest.mark.parametrize("name", ["four_finger_hand", pytest.param("shadow_hand", marks=needs_wheel)])


def loaded(name: str) -> Scene:
    """The scene of an example."""
    return load_scene(EXAMPLES / name / "scene.yaml")


def one_of_each(scene: Scene) -> list[EffectSetting]:
    """Each effect that can act, its first parameter's farthest probe in its first component."""
    found = []
    for name in (n for n in effect_names() if effect(n).possible(scene)):
        x = flatten(EffectSetting(name=name), scene)
        # The farthest torque limit is a loose one: it limits nothing.
        x[0] = effect(name).parameters[0].probes(scene)[0 if name == "torque_limit" else -1]
        found.append(setting(name, x, scene))
    return found


@BOTH
def test_every_effect_that_can_act_moves_something(name):
    scene = loaded(name)
    plan = policy("squeeze").plan(scene, np.random.default_rng(1), 0.5)
    some = one_of_each(scene)
    assert len(some) >= 30
    tile = [np.repeat(a[None], len(some) + 1, axis=0) for a in (plan.commands, plan.qpos, plan.qvel)]
    played = rollout(scene, *tile, [(), *((s,) for s in some)]).readings
    for row, s in enumerate(some, start=1):
        assert all(np.isfinite(v[row]).all() for v in played.values()), s
        assert any(not np.array_equal(v[row], v[0]) for v in played.values()), s


def own_values_lie_within_bounds(scene: Scene) -> None:
    for name in (n for n in effect_names() if effect(n).possible(scene)):
        for p in effect(name).parameters:
            own = (p.neutral or p.identity)(scene)
            assert np.isnan(own) or p.bounds(scene).low <= own <= p.bounds(scene).high, (name, p.name)


@BOTH
def test_a_models_own_values_lie_within_the_bounds(name):
    own_values_lie_within_bounds(loaded(name))


def test_so_do_those_of_a_wrist_ten_times_as_strong_as_the_fingers(tmp_path):
    links = "".join(
        f'<body pos=".1 0 0"><joint name="{n}"/><geom type="capsule" fromto="0 0 0 .1 0 0" size=".01"/>' for n in "abc"
    )
    limits = {"a": 5, "b": 0.5, "c": 0.5}
    servos = "".join(f'<position name="{n}" joint="{n}" kp="9" forcerange="-{t} {t}"/>' for n, t in limits.items())
    model = f"<mujoco><worldbody>{links}{'</body>' * 3}</worldbody><actuator>{servos}</actuator></mujoco>"
    (tmp_path / "hand.xml").write_text(model)
    (tmp_path / "scene.yaml").write_text("model: hand.xml\nrate_hz: 100\njoints: [a, b, c]\nactuators: [a, b, c]\n")
    scene = load_scene(tmp_path / "scene.yaml")
    own_values_lie_within_bounds(scene)
    limit = weakened(scene, setting("torque_limit", np.array([0.1]), scene), 0.25)
    assert 0.5 < flatten(limit, scene)[0] < 5


@needs_wheel
def test_what_the_shadow_hand_lacks_is_no_candidate():
    """Its servos have no velocity gain to scale, its palm no height of its own, and its block no explicit pairs.

    Its links may weigh too little for its drives.
    """
    scene = loaded("shadow_hand")
    lacking = {n for n in effect_names() if not effect(n).possible(scene) and effect(n).acts_on != "link"}
    assert lacking == {"servo_damping", "support_height", "anisotropic_friction"}


@needs_wheel
def test_the_shadow_hand_touches_its_block_and_couples_its_joints():
    scene = loaded("shadow_hand")
    assert (len(scene.file.joints), len(scene.actuator_ids), len(scene.driven_hinges)) == (24, 20, 20)
    made = make_episodes(scene, [EpisodeJob(f"s{i}", i, "squeeze", 11) for i in range(2)], duration_s=2.0)
    for e in made:
        assert e["fingertip_contact"].any(), "a fingertip reaches the block"
        assert not e["contact"][0], "an episode begins before contact"
        # The tendon T_LFJ1c ties the two outer joints of a finger: |0.00705 J0 - 0.00805 J1| < 0.001 m, give or take.
        outer, inner = (e["joint_position"][:, scene.file.joints.index(f"robot0:LFJ{i}")] for i in (0, 1))
        assert np.ptp(inner) > 0.3
        assert np.abs(0.00705 * outer - 0.00805 * inner).max() < 0.003


def test_bodies_need_no_names(tmp_path):
    """Sensors refer to names: bodies that have none get one, and read the same."""
    bare = JAWS.replace('<body name="rail"', "<body").replace('<body name="left"', "<body")
    plain, unnamed = (write(folder, xml, JAWS_ROLES) for folder, xml in folders(tmp_path, JAWS, bare))
    made = [make_episodes(s, [EpisodeJob("g", 0, "grasp_lift_shake", 1)], duration_s=1.0)[0] for s in (plain, unnamed)]
    assert made[0]["contact"].any()
    for channel in ("object_pose", "fingertip_force"):
        assert np.array_equal(made[0][channel], made[1][channel])


def folders(root: Path, *texts: str) -> list[tuple[Path, str]]:
    """A new folder for each text."""
    made = [(root / str(i), text) for i, text in enumerate(texts)]
    for folder, _ in made:
        folder.mkdir()
    return made


def test_a_model_in_a_package_that_is_not_there_says_how_to_get_it(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text("model: no_such_package:hand.xml\nrate_hz: 50\n")
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    assert str(caught.value) == (
        "the model lies in the package no_such_package, which is not installed\n"
        f"  expected: no_such_package:hand.xml\n  where: {path}\n  do: pip install no-such-package"
    )


def test_a_package_without_the_file_says_where_it_looked(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text("model: candata:no_such_hand.xml\nrate_hz: 50\n")
    with pytest.raises(SceneError, match=r"candata/no_such_hand\.xml"):
        load_scene(path)
