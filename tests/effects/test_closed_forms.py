"""Effects against closed forms."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from candata.effects._contact import time_form
from candata.gap.replay.replayer import sense
from candata.rotation import difference
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting
from candata.simulate import at_rest, rollout, true_state
from candata.simulate.timing import resample_control, retime_commands
from candata.simulate.world import build_worlds
from tests.effects.gripper import XML, grip, play_grip, write_scene

G = 9.81


def setting(name: str, element: str | None = None, **parameters) -> EffectSetting:
    return EffectSetting(name=name, element=element, parameters=parameters)


def model_of(scene, *some: EffectSetting) -> mujoco.MjModel:
    return build_worlds(scene, [some]).models[0]


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """One link in the horizontal plane: nothing but its servo moves it."""
    xml = """
    <mujoco><compiler angle="radian"/><option timestep="0.0025" integrator="implicitfast"/><worldbody>
    <body><joint name="a" axis="0 0 1" armature="1e-3"/><geom type="capsule" size="0.01" fromto="0 0 0 0.1 0 0"/></body>
    </worldbody><actuator><position name="a" joint="a" kp="2" kv="0.2" ctrlrange="-1 1"/></actuator></mujoco>
    """
    roles = "model: scene.xml\nrate_hz: 80\njoints: [a]\nactuators: [a]\n"
    return write_scene(tmp_path_factory.mktemp("arm"), xml, roles)


@pytest.fixture(scope="module")
def toss():
    return load_scene("cube_toss")


def follow(scene, target, *some: EffectSetting, keep: bool = False):
    """Readings (and true positions) of one joint that follows `target (T,)`."""
    played = rollout(scene, np.asarray(target, float)[None, :, None], *at_rest(scene, 1), [some], keep_state=keep)
    return played.readings["joint_position"][0, :, 0], played.qpos[0, :, 0] if keep else None


def test_the_servo_brings_the_reading_to_the_target(arm):
    read, true = follow(arm, np.full(240, 0.4), setting("joint_offset", offset_rad=0.05), keep=True)
    # After 3 s, over thirty time constants kv / kp, the servo is at rest.
    assert read[-1] == pytest.approx(0.4, abs=1e-6)
    assert true[-1] == pytest.approx(0.35, abs=1e-6)
    assert read[0] == pytest.approx(0.05, abs=1e-12), "the arm stands at zero and reads its offset"


def test_gain_and_offset_are_the_same_world_in_either_order(arm):
    two = setting("servo_gain", kp_scale=2.0), setting("joint_offset", offset_rad=0.05)
    one, other = model_of(arm, *two), model_of(arm, *two[::-1])
    assert np.array_equal(one.actuator_biasprm, other.actuator_biasprm)
    # kp (u - q - offset) with kp = 4.
    np.testing.assert_allclose(one.actuator_biasprm[0, :2], [-4 * 0.05, -4])


def test_an_offset_is_taken_off_a_recording(gripper):
    some = (setting("joint_offset", offset_rad=(0.05, -0.02)), setting("joint_offset", "left", offset_rad=0.01))
    true = true_state(gripper, {"joint_position": np.zeros((3, 4, 3))}, some)["joint_position"]
    np.testing.assert_allclose(true, np.broadcast_to([0.0, -0.06, 0.02], (3, 4, 3)), atol=1e-15)


def test_backlash_is_a_dead_zone_of_the_command(arm):
    gap = setting("backlash", gap_rad=0.1)
    inside, _ = follow(arm, np.r_[0.0, np.full(240, 0.049)], gap)
    assert np.abs(inside).max() == 0
    up, _ = follow(arm, np.r_[0.0, np.full(240, 0.4)], gap)
    assert up[-1] == pytest.approx(0.35, abs=1e-6)
    # Back by less than the gap: nothing moves; by more: the rest of it.
    stays, _ = follow(arm, np.r_[0.0, np.full(240, 0.4), np.full(240, 0.31)], gap)
    assert stays[-1] == pytest.approx(0.35, abs=1e-6)
    back, _ = follow(arm, np.r_[0.0, np.full(240, 0.4), np.full(240, 0.1)], gap)
    assert back[-1] == pytest.approx(0.15, abs=1e-6)


def test_more_servo_damping_is_slower_in_proportion(arm):
    step = np.full(40, 0.1)
    slow, _ = follow(arm, step, setting("servo_damping", kv_scale=8.0))
    # Overdamped (kv = 1.6): the slow pole is kp / kv but for inertia / kv^2 kp, below 0.1 %, and the 2.5 ms steps of
    # an implicit method, 0.5 h kp / kv = 0.2 %. The start takes inertia / kv = 1 ms.
    time_s = np.arange(40) / 80
    np.testing.assert_allclose(slow, 0.1 * (1 - np.exp(-time_s * 2 / 1.6)), atol=3e-4)


def test_a_lag_answers_a_step_as_first_order(hand):
    tau = 0.05
    hook = build_worlds(hand, [(setting("tactile_lag", timeconst_s=tau),), ()]).reading[0]
    state, read = hook.state, []
    for k in range(30):
        force = np.full((2, 5, 3), float(k > 0))
        state, out = hook.apply(state, {"fingertip_force": force})
        read.append(out["fingertip_force"][:, 2, 1])
    lagging, plain = np.array(read).T
    np.testing.assert_allclose(lagging, 1 - np.exp(-np.arange(30) / hand.file.rate_hz / tau), atol=1e-12)
    assert np.array_equal(plain, np.arange(30) > 0)


def test_a_lag_begins_at_the_first_force_that_is_known(hand):
    """A replay that starts later than its recording has no forces before: they were lost for all later rows too."""
    forces = np.ones((1, 20, 5, 3))
    forces[:, :8] = np.nan
    forces[:, 8:10] = 0.0
    read = sense(hand, {"fingertip_force": forces}, (setting("tactile_lag", timeconst_s=6e-4),))["fingertip_force"]
    np.testing.assert_allclose(read, forces, atol=1e-6)  # 6e-4 s is a twentieth of a row: nothing is left of the lag


def test_a_dead_band_swallows_small_components_and_no_others(hand):
    hook = build_worlds(hand, [(setting("tactile_dead_band", band_N=0.3),)]).reading[0]
    force = np.tile([0.29, -0.29, 2.0], (1, 5, 1))
    _, out = hook.apply(hook.state, {"fingertip_force": force})
    assert np.array_equal(out["fingertip_force"], np.tile([0.0, 0.0, 2.0], (1, 5, 1)))


def test_a_gain_scales_the_force_and_not_the_offset(hand):
    """A fingertip reads gain times force plus offset, then what its firmware swallows; replays read it alike."""
    given = (
        setting("tactile_bias", bias_N=(0.1,) * 15),
        setting("tactile_dead_band", band_N=0.3),
        setting("tactile_gain", gain=2.0),
    )
    force = np.tile([0.05, 0.15, 1.0], (1, 5, 1))
    out = {"fingertip_force": force}
    for hook in build_worlds(hand, [given]).reading:
        _, out = hook.apply(hook.state, out)
    expected = np.tile([0.0, 0.4, 2.1], (1, 5, 1))
    np.testing.assert_allclose(out["fingertip_force"], expected)
    np.testing.assert_allclose(
        sense(hand, {"fingertip_force": force[:, None]}, given)["fingertip_force"][:, 0], expected
    )


POSE_EFFECTS = [
    setting("pose_bias", bias_m=(0.01, -0.02, 0.03)),
    setting("pose_rotation_bias", bias_rad=(0.1, 0.0, -0.2)),
    setting("pose_scale", scale=1.05),
]


@pytest.mark.parametrize("given", POSE_EFFECTS, ids=lambda s: s.name)
def test_a_pose_effect_changes_the_reading_as_it_says_and_back(gripper, given):
    plain, read = play_grip(gripper, [(), (given,)]).readings["object_pose"]
    value = np.array(next(iter(given.parameters.values())))
    shift = {"pose_bias": value, "pose_scale": 0.05 * plain[:, :3]}.get(given.name, 0.0)
    turn = value if given.name == "pose_rotation_bias" else np.zeros(3)
    np.testing.assert_allclose(read[:, :3], plain[:, :3] + shift, atol=1e-15)
    np.testing.assert_allclose(difference(read[:, 3:], plain[:, 3:]), np.broadcast_to(turn, (len(plain), 3)), atol=1e-9)
    np.testing.assert_allclose(true_state(gripper, {"object_pose": read}, (given,))["object_pose"], plain, atol=1e-12)


def test_what_is_put_on_in_order_is_taken_off_in_reverse(gripper):
    plain, read = play_grip(gripper, [(), tuple(POSE_EFFECTS)]).readings["object_pose"]
    true = true_state(gripper, {"object_pose": read}, tuple(POSE_EFFECTS))["object_pose"]
    np.testing.assert_allclose(true, plain, atol=1e-12)


def test_a_fall_measured_with_long_lengths_looks_like_more_gravity(toss):
    qpos, qvel = at_rest(toss, 1)
    given = setting("pose_scale", scale=1.05)
    worlds = [(), (given,)]
    tile = [np.repeat(a, 2, axis=0) for a in (np.zeros((1, 20, 0)), qpos, qvel)]
    z = rollout(toss, *tile, worlds).readings["object_pose"][:, :, 2]
    fall = np.diff(z, 2, axis=1)
    np.testing.assert_allclose(fall[1], 1.05 * fall[0], atol=1e-12)


def test_the_object_rests_on_a_raised_support_and_at_its_own_size(toss):
    up, large = setting("support_height", height_m=0.01), setting("object_size", scale=1.1)
    worlds = [(), (up,), (large,)]
    qpos, qvel = at_rest(toss, 3)
    qpos[:, 2] = 0.07
    z = rollout(toss, np.zeros((3, 300, 0)), qpos, qvel, worlds).readings["object_pose"][:, -1, 2]
    half = toss.model.geom("object").size[2]
    assert z[0] == pytest.approx(half, abs=1e-3), "soft contact gives way by less than a millimetre"
    # The same weight on the same contact sinks equally deep, up to what is left of the bounce after 2 s.
    assert z[1] - z[0] == pytest.approx(0.01, abs=2e-5)
    assert z[2] - z[0] == pytest.approx(0.1 * half, abs=2e-5)


def test_a_scaled_object_is_the_one_a_scaled_model_compiles_to(tmp_path):
    def built(folder, scale):
        folder.mkdir()
        half, place = 0.02 * scale, 0.01 * scale
        body = (
            f'<body name="box" pos="0 0.003 0.02"><freejoint/><inertial mass="0.1" pos="{place} 0 0" '
            f'diaginertia="1e-4 1e-4 1e-4"/><geom name="box" type="box" size="{half} {half} {half}"/>'
            f'<geom type="sphere" size="{half}" pos="{place} 0 0"/><site name="s" pos="0 0 {place}"/></body>'
        )
        start, end = XML.index('<body name="box"'), XML.index("</worldbody>")
        return write_scene(folder, XML[:start] + body + XML[end:])

    edited = model_of(built(tmp_path / "a", 1.0), setting("object_size", scale=1.2))
    compiled = built(tmp_path / "b", 1.2).model
    for field in (
        "geom_size",
        "geom_pos",
        "geom_rbound",
        "geom_aabb",
        "site_pos",
        "body_ipos",
        "body_mass",
        "body_inertia",
        "bvh_aabb",
        "dof_M0",
    ):
        np.testing.assert_allclose(getattr(edited, field), getattr(compiled, field), atol=1e-12, err_msg=field)


def test_a_scaled_mesh_is_the_one_a_scaled_model_compiles_to(tmp_path):
    def built(folder, scale):
        folder.mkdir()
        corners = " ".join(f"{x * 0.02} {y * 0.02} {z * 0.02}" for x in (-1, 1) for y in (-1, 1) for z in (-1, 1))
        asset = f'<asset><mesh name="m" vertex="{corners}" scale="{scale} {scale} {scale}"/></asset>'
        old = '<geom name="box" type="box" size="0.02 0.02 0.02" mass="0.1"/>'
        new = '<inertial mass="0.1" pos="0 0 0" diaginertia="1e-4 1e-4 1e-4"/><geom name="box" type="mesh" mesh="m"/>'
        return write_scene(folder, XML.replace(old, new).replace("<worldbody>", asset + "<worldbody>"))

    edited = model_of(built(tmp_path / "a", 1.0), setting("object_size", scale=1.2))
    compiled = built(tmp_path / "b", 1.2).model
    for field in ("mesh_vert", "geom_size", "geom_pos", "geom_rbound", "geom_aabb", "bvh_aabb"):
        # Mesh vertices are single precision.
        np.testing.assert_allclose(getattr(edited, field), getattr(compiled, field), atol=1e-8, err_msg=field)


def test_inertia_is_scaled_and_mass_is_not(toss):
    model = model_of(toss, setting("object_inertia", inertia_scale=2.0))
    body = toss.object_id
    assert np.array_equal(model.body_inertia[body], 2 * toss.model.body_inertia[body])
    assert model.body_mass[body] == toss.model.body_mass[body]


def test_contact_damping_is_the_damping_ratio_whichever_form_the_model_has(toss):
    model = model_of(toss, setting("contact_damping", dampratio=0.3))
    assert model.geom_solref[toss.object_geoms].tolist() == [[0.02, 0.3]]
    # Direct form (-k, -b) of time constant 0.02 s and ratio 0.5: k = 1 / (0.02 x 0.5)^2, b = 2 / 0.02.
    np.testing.assert_allclose(time_form(np.array([[-1e4, -100.0]])), [[0.02, 0.5]])


@pytest.mark.parametrize("share", [1.0, 2.0])
def test_softer_fingertips_stay_softer_at_another_depth_of_contacts(share):
    scene = load_scene("gripper_tabletop")
    before, tips = scene.model.geom_solimp[:, 2], scene.model.geom_solimp[:, 2] > 0.002
    own = float(before[scene.object_geoms[0]])
    after = model_of(scene, setting("solimp_width", width_m=share * own)).geom_solimp[:, 2]
    assert after[tips] == pytest.approx(share * 0.005)
    assert after[scene.object_geoms] == pytest.approx(share * own)


def test_a_time_step_divides_the_control_step(toss, hand):
    for scene, asked, steps in ((toss, 1e-3, 7), (hand, 1.25e-3, 10), (hand, 6.25e-3, 2), (hand, 3e-3, 4)):
        model = model_of(scene, setting("time_step", time_step_s=asked))
        assert model.opt.timestep * steps == pytest.approx(1 / scene.file.rate_hz, rel=1e-12)


def test_free_fall_takes_the_time_step_it_is_given(toss):
    half = setting("time_step", time_step_s=toss.model.opt.timestep / 2)
    tile = [np.repeat(a, 2, axis=0) for a in (np.zeros((1, 20, 0)), *at_rest(toss, 1))]
    z = rollout(toss, *tile, [(), (half,)]).readings["object_pose"][:, :, 2]
    k, h = np.arange(20) * 10, toss.model.opt.timestep
    np.testing.assert_allclose(z[0], z[0, 0] - G * h**2 * k * (k + 1) / 2, atol=1e-12)
    np.testing.assert_allclose(z[1], z[0, 0] - G * (h / 2) ** 2 * 2 * k * (2 * k + 1) / 2, atol=1e-12)


def test_controls_keep_their_mean_at_another_step(rng):
    control = rng.standard_normal((2, 5, 3))
    assert resample_control(control, 5) is control
    np.testing.assert_allclose(resample_control(control, 10), np.repeat(control, 2, axis=1), atol=1e-12)
    np.testing.assert_allclose(resample_control(control, 1), control.mean(1, keepdims=True), atol=1e-12)
    np.testing.assert_allclose(resample_control(control, 2).mean(1), control.mean(1), atol=1e-12)


@pytest.mark.parametrize("pace", [0.5, 0.98, 1.02, 2.0])
def test_a_ramp_is_played_at_another_pace_once_the_recording_has_begun(pace):
    rows, steps, settle = 40, 5, 8
    ramp = np.arange(rows, dtype=float)[None, :, None]
    own = retime_commands(ramp, np.array([pace]), steps, settle)[0, :, :, 0]
    assert np.allclose(own[:settle], ramp[0, :settle])
    time = settle + (np.arange(rows)[:, None] - settle + np.arange(steps) / steps) * pace
    # Held commands are at most one row behind the ramp; the last is held for ever.
    behind = np.minimum(time, rows - 1)[settle:] - own[settle:]
    assert (behind > -0.2 * pace - 1e-9).all()
    assert (behind < 1 + 1e-9).all()


@pytest.mark.parametrize("ppm", [-20000.0, 20000.0])
def test_a_fast_clock_sees_the_world_earlier(gripper, ppm):
    drift = setting("clock_drift", ppm=ppm)
    plain, drifting = play_grip(gripper, [(), (drift,)]).readings["joint_position"][..., 1]
    rows = np.arange(len(plain))
    expected = np.interp(rows / (1 + ppm * 1e-6), rows, plain)
    # 20 ms at the end, when the fastest joint moves at 3 rad/s.
    assert np.abs(drifting - plain).max() > 0.01
    inner = rows < 90
    # A straight line between rows is off by 4 mrad where the fingers hit the box.
    np.testing.assert_allclose(drifting[inner], expected[inner], atol=4e-3)


def test_a_crystal_s_drift_cannot_be_seen_in_a_second(gripper):
    plain, drifting = play_grip(gripper, [(), (setting("clock_drift", ppm=50.0),)]).readings["joint_position"]
    # 50 ppm are 60 us in 1.2 s; the fastest joint moves at 3 rad/s. Encoders resolve 0.3 mrad at best.
    assert np.abs(drifting - plain).max() < 3e-4


def test_the_clock_starts_with_the_recording(gripper):
    commands = np.concatenate([np.repeat(grip()[:, :1], 30, axis=1), grip()], axis=1)
    drift = [(setting("clock_drift", ppm=20000.0),)]
    later = rollout(gripper, commands, *at_rest(gripper, 1), drift, settle=30).readings["joint_position"][0, 30:, 1:]
    at_once = play_grip(gripper, drift).readings["joint_position"][0, :, 1:]
    # The same motion of the fingers; the rail has sunk by 2 mm in one and not yet in the other.
    np.testing.assert_allclose(later, at_once, atol=1e-3)


def test_anisotropic_friction_is_the_second_direction_s(gripper):
    model = model_of(gripper, setting("anisotropic_friction", ratio=0.5))
    np.testing.assert_allclose(model.pair_friction[:, 1], 0.5 * gripper.model.pair_friction[:, 0])
    assert np.array_equal(model.pair_friction[:, 0], gripper.model.pair_friction[:, 0])


def test_rolling_friction_stops_a_ball(tmp_path):
    xml = """
    <mujoco><option timestep="0.0025" cone="elliptic"/><worldbody><geom name="floor" type="plane" size="5 5 0.1"/>
    <body name="ball" pos="0 0 0.05"><freejoint/><geom type="sphere" size="0.05" mass="0.2"/></body>
    </worldbody></mujoco>
    """
    scene = write_scene(tmp_path, xml, "model: scene.xml\nrate_hz: 80\nobject: ball\nsupport: floor\n")
    qpos, qvel = (np.repeat(a, 2, axis=0) for a in at_rest(scene, 1))
    qvel[:, [0, 4]] = 0.5, 10.0
    worlds = [(), (setting("rolling_friction", rolling_m=0.005),)]
    x = rollout(scene, np.zeros((2, 81, 0)), qpos, qvel, worlds).readings["object_pose"][..., 0]
    assert x[0, -1] == pytest.approx(0.5, rel=0.02), "a ball on a plane rolls on"
    # Torque m g c against 7/5 m r^2 at the point of contact: a = g c / (7/5 r) = 0.70 m/s^2, v^2 / 2 a = 0.178 m.
    assert x[1, -1] == pytest.approx(0.25 / (2 * G * 0.005 / (1.4 * 0.05)), rel=0.05)
