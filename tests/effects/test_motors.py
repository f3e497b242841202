"""Servos as DC motors: the same motion until a voltage is limited, and closed forms of what is then."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from candata.effects import _motor, _select, effect
from candata.gap.data.lag import drives
from candata.policies._drive import servos
from candata.repair import export_mjcf
from candata.scenes import load_scene, motors
from candata.scenes.drives import drive_of
from candata.schema.effect import EffectSetting
from candata.simulate import at_rest, rollout
from candata.simulate.world import build_worlds
from tests.effects.pendulum import SERVO, excitation, write_pendulum
from tests.effects.sagging import SUPPLY_V, play_on_weak_supply

LIMIT_NM, KP, KV = 0.3, 2.0, 0.06


def setting(name: str, **parameters) -> EffectSetting:
    return EffectSetting(name=name, parameters=parameters)


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    return write_pendulum(tmp_path_factory.mktemp("pendulum"))


def motion(model: mujoco.MjModel, commands: np.ndarray, substeps: int = 4) -> np.ndarray:
    """Positions `(T,)` of plain MuJoCo."""
    data, out = mujoco.MjData(model), []
    for command in commands:
        data.ctrl[:] = command
        for _ in range(substeps):
            mujoco.mj_step(model, data)
        out.append(data.qpos[0])
    return np.array(out)


def follow(scene, commands, *effects: EffectSetting, start: float = 0.0) -> np.ndarray:
    """Positions `(T,)` of one joint that follows commands `(T, 1)`."""
    qpos, qvel = at_rest(scene, 1)
    played = rollout(scene, np.asarray(commands, float)[None], qpos + start, qvel, [effects])
    return played.readings["joint_position"][0, :, 0]


@pytest.mark.parametrize("limit", ["", 'forcerange="-0.3 0.3"', 'forcerange="-0.1 0.3"'])
@pytest.mark.parametrize("integrator", ["Euler", "RK4", "implicit", "implicitfast", "discrete"])
def test_a_servo_and_its_motor_move_alike(tmp_path, integrator, limit):
    servo = SERVO.replace('forcerange="-0.3 0.3"', limit)
    scene = write_pendulum(tmp_path, servo, integrator=integrator)
    motor = build_worlds(scene, [()]).models[0].__copy__()
    _motor.convert(motor, scene.actuator_ids)
    own, converted = (motion(model, excitation(1)) for model in (scene.model, motor))
    assert np.ptp(own) > 1
    assert np.abs(converted - own).max() < 1e-9
    motor.actuator_gainprm[0, motors.VOLTAGE] = 0.1
    assert np.abs(motion(motor, excitation(1)) - own).max() > 0.1, "a limit of the voltage shows"


def test_a_motor_by_its_fields_is_the_one_that_mujoco_compiles(pendulum, tmp_path):
    """The places in `gainprm` are those of the compiler."""
    element = (
        '<dcmotor name="a" joint="a" input="pos" motorconst="0.2 0.2" resistance="0.4" controller="2 0 0.06 0 0 0.7" '
        'saturation="0.3 0 0" ctrlrange="-3 3"/>'
    )
    compiled = write_pendulum(tmp_path, element).model
    motor = pendulum.model.__copy__()
    _motor.convert(motor, pendulum.actuator_ids)
    motor.actuator_gainprm[0, [motors.RESISTANCE, motors.CONSTANT, motors.VOLTAGE]] = 0.4, 0.2, 0.7
    names = [n for n in dir(motor) if n.startswith("actuator_") and isinstance(getattr(motor, n), np.ndarray)]
    different = [n for n in names if not np.array_equal(getattr(motor, n), getattr(compiled, n))]
    assert different == []


def test_a_scene_of_motors_is_read_as_one_of_position_servos(pendulum, tmp_path):
    """A repaired model is the nominal one of the next diagnosis."""
    export = export_mjcf(pendulum, [setting("drive_voltage", voltage_scale=1.2)], tmp_path / "out")
    scene, ids = load_scene(tmp_path / "out" / export.scene), pendulum.actuator_ids
    assert motors.is_position_motor(scene.model, ids).all()
    assert scene.stiffness(ids) == pendulum.stiffness(ids)
    assert drive_of(scene.model, 0)[1:] == drive_of(pendulum.model, 0)[1:]
    assert _select.drive_damping(scene) == _select.drive_damping(pendulum)
    assert (servos(scene) == servos(pendulum)).all()
    assert drives(scene) == drives(pendulum)
    changed = (setting("servo_gain", kp_scale=1.5), setting("servo_damping", kv_scale=0.5))
    again, own = build_worlds(scene, [changed]).models[0], build_worlds(pendulum, [changed]).models[0]
    for one, other in zip(motors.affine_law(again, ids), motors.affine_law(own, ids), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)
    # Commands stay within +-0.1 rad of the arm, where no voltage is limited.
    slow = 0.05 * excitation(1)
    np.testing.assert_allclose(follow(scene, slow, *changed), follow(pendulum, slow, *changed), atol=1e-9)


def test_a_motor_out_of_voltage_turns_no_faster_than_its_no_load_speed(pendulum):
    """Without weight or friction, a share s of the supply gives s times the usual no-load speed."""
    scene = pendulum
    free = scene.model.__copy__()
    free.opt.gravity[:], free.dof_damping[:] = 0, 0
    _motor.set_stall_share(free, scene, scene.actuator_ids, 0.5)
    data = mujoco.MjData(free)
    data.ctrl[0] = 3.0
    speeds = []
    while data.qpos[0] < 2:
        mujoco.mj_step(free, data)
        speeds.append(data.qvel[0])
    # The torque that is left falls with speed: 1 - exp(-t / T), T = inertia / slope = 0.05 s; 2 rad take over 0.6 s.
    assert speeds[-1] == pytest.approx(0.5 * _motor.NO_LOAD_RAD_S, rel=1e-3)


def test_a_motor_in_pwm_mode_is_a_clamped_voltage(pendulum):
    """kd = K^2 / R: torque = clamp(kp error, stall) - K^2 / R speed, as drives without a current loop have it."""
    motor = pendulum.model.__copy__()
    motor.actuator_forcelimited[0] = False
    _motor.set_stall_share(motor, pendulum, pendulum.actuator_ids, 0.6)
    _motor.set_slope(motor, pendulum, pendulum.actuator_ids, KV)
    data, commands = mujoco.MjData(motor), excitation(2)
    for command in commands:
        data.ctrl[:] = command
        for _ in range(4):
            torque = np.clip(KP * (command[0] - data.qpos[0]), -0.6 * LIMIT_NM, 0.6 * LIMIT_NM) - KV * data.qvel[0]
            mujoco.mj_step(motor, data)
            assert data.actuator_force[0] == pytest.approx(torque, abs=1e-12)


def test_edits_of_the_servo_and_of_its_motor_are_one_world_in_any_order(pendulum):
    some = (
        setting("drive_voltage", voltage_scale=0.4),
        setting("servo_gain", kp_scale=1.5),
        setting("back_emf", emf_Nms_rad=0.08),
        setting("servo_damping", kv_scale=2.0),
        setting("joint_offset", offset_rad=0.1),
        setting("torque_limit", limit_Nm=0.25),
    )
    one, other = (follow(pendulum, excitation(3), *effects) for effects in (some, some[::-1]))
    np.testing.assert_allclose(one, other, atol=1e-12)
    model = build_worlds(pendulum, [some]).models[0]
    np.testing.assert_allclose(
        model.actuator_gainprm[0, [motors.KP, motors.KD, motors.CONSTANT, motors.VOLTAGE]],
        [1.5 * KP, 2 * KV, 0.08, 0.4 * LIMIT_NM],
    )


def test_an_encoder_offset_acts_inside_the_limit_of_the_voltage(pendulum):
    """The motor's law has no constant: commands move instead, and so does their range."""
    offset, weak = setting("joint_offset", offset_rad=0.1), setting("drive_voltage", voltage_scale=0.5)
    commands = excitation(4)
    read = follow(pendulum, commands, offset, weak)
    shifted = follow(pendulum, commands - 0.1, weak)
    np.testing.assert_allclose(read, shifted + 0.1, atol=1e-12)


def test_where_no_servo_can_be_a_motor_the_effects_cannot_act(tmp_path):
    servos = {
        "torque": '<motor name="a" joint="a" forcerange="-1 1"/>',
        "unlimited": '<position name="a" joint="a" kp="2" kv="0.06"/>',
        "filtered": SERVO.replace("/>", ' timeconst="0.05"/>'),
        "units": '<general name="a" joint="a" biastype="affine" gainprm="1" biasprm="0 -2" forcerange="-1 1"/>',
    }
    for name, servo in servos.items():
        scene = write_pendulum(tmp_path / name, servo)
        assert not effect("drive_voltage").possible(scene), name
        assert not effect("back_emf").possible(scene), name
    assert effect("drive_voltage").possible(load_scene("xhand_tabletop"))


def test_a_set_point_moves_at_its_speed_and_no_faster(pendulum):
    """A slow ramp passes; a step becomes a ramp that ends at the step."""
    limit = setting("speed_limit", speed_rad_s=1.0)
    slow = np.linspace(0, 0.9, 101)[:, None]
    # The steps of 9 mrad between rows become ramps.
    assert np.abs(follow(pendulum, slow, limit) - follow(pendulum, slow)).max() < 0.009
    step = np.r_[0.0, np.full(150, 0.5)][:, None]
    # Each physics step of 2.5 ms moves by 2.5 mrad; held commands of 10 ms would be off by up to 7.5 mrad.
    ramp = rollout(
        pendulum, np.minimum(np.arange(151) / 100, 0.5)[None, :, None], *at_rest(pendulum, 1), [()]
    ).readings["joint_position"][0, :, 0]
    limited = follow(pendulum, step, limit)
    assert np.abs(limited - ramp).max() < 0.02
    assert limited[-1] == pytest.approx(ramp[-1], abs=1e-6)
    assert np.abs(limited - follow(pendulum, step)).max() > 0.2


def test_a_limited_set_point_is_exported_as_a_motor_of_plain_mujoco(pendulum, tmp_path):
    effects = (setting("speed_limit", speed_rad_s=0.8), setting("drive_voltage", voltage_scale=0.6))
    export = export_mjcf(pendulum, effects, tmp_path / "out")
    assert (len(export.held), export.left) == (2, ())
    plain = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / export.model))
    commands = excitation(5)
    own = follow(pendulum, commands, *effects)
    # Rows are read before their command is held; the activation is the set point, which begins at the first command, 0.
    np.testing.assert_allclose(motion(plain, commands)[:-1], own[1:], atol=1e-9)
    assert np.abs(follow(pendulum, commands) - own).max() > 0.1


def test_a_limited_set_point_of_what_is_no_servo_is_left_with_the_reason(tmp_path):
    scene = write_pendulum(tmp_path / "scene", SERVO.replace("/>", ' timeconst="0.05"/>'))
    export = export_mjcf(scene, [setting("speed_limit", speed_rad_s=0.8)], tmp_path / "out")
    assert export.held == ()
    (entry,) = export.left
    assert "DC motors alone" in entry.why


def test_friction_that_fades_holds_at_rest_and_is_gone_at_speed(pendulum, tmp_path):
    """At rest it is dry friction of the same size; at ten times the speed of fading nothing is left."""
    limp = write_pendulum(tmp_path, SERVO.replace('kp="2" kv="0.06"', 'kp="1e-6" kv="0"'))
    extra = setting("stribeck", breakaway_Nm=0.15)
    rest = np.zeros((100, 1))
    # The arm pulls with 0.1 x 0.1 x 9.81 N m from the sphere and half of a fifth of that from the rod: 0.108 N m.
    held, dry = (follow(limp, rest, s) for s in (extra, setting("joint_dry_friction", frictionloss_Nm=0.15)))
    # MuJoCo's friction is soft: both creep, by 0.05 rad in a second, where 3 % of the extra friction are gone.
    assert np.abs(held).max() < 0.06
    np.testing.assert_allclose(held, dry, rtol=0.1)
    assert np.ptp(follow(limp, rest, setting("stribeck", breakaway_Nm=0.1))) > 0.5, "less than the weight does not hold"
    start = np.zeros((2, 1)), np.full((2, 1), 3.0)
    fast, free = rollout(limp, np.repeat(rest[None], 2, 0), *start, [(extra,), ()]).readings["joint_position"]
    assert free[20] > 0.5
    np.testing.assert_allclose(fast[:20], free[:20], atol=1e-6)


def test_friction_of_load_is_a_share_of_the_motors_torque(pendulum):
    """Held up and let down slowly, the servo's torque differs by what friction takes of it: (1 + s) / (1 - s)."""
    share = 0.4
    up_and_down = np.r_[np.linspace(0.3, -0.3, 600), np.linspace(-0.3, 0.3, 600)][:, None]
    torque = {}
    for name, effects in {"plain": (), "gears": (setting("load_friction", torque_share=share),)}.items():
        position = follow(pendulum, up_and_down, *effects, start=0.3)
        torque[name] = KP * (up_and_down[:, 0] - position) - KV * np.gradient(position, 0.01)
    middle_up, middle_down = slice(250, 350), slice(850, 950)
    weight = np.abs(torque["plain"][middle_up]).mean()
    # Friction is a share of the torque with which the motor works against it or is helped by it.
    assert np.abs(torque["gears"][middle_up]).mean() == pytest.approx(weight / (1 - share), rel=0.05)
    assert np.abs(torque["gears"][middle_down]).mean() == pytest.approx(weight / (1 + share), rel=0.05)


def test_worlds_of_changing_friction_do_not_share_it(pendulum):
    """Two worlds of one model, one of them without friction, move as each alone does."""
    commands, gears = excitation(6), setting("load_friction", torque_share=0.5)
    both = rollout(pendulum, np.repeat(commands[None], 2, 0), *at_rest(pendulum, 2), [(gears,), ()])
    for row, effects in enumerate([(gears,), ()]):
        assert np.array_equal(both.readings["joint_position"][row, :, 0], follow(pendulum, commands, *effects))
    assert pendulum.model.dof_frictionloss[0] == 0


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
def test_a_servo_follows_its_recorded_supply_as_plain_mujoco_does(tmp_path, integrator):
    """Gain and stall torque are those of each row; half of the share is half of the sag."""
    scene, commands = write_pendulum(tmp_path, integrator=integrator), excitation(7)
    sagging, volts = play_on_weak_supply(scene, commands)
    assert volts.min() < 0.8 * SUPPLY_V
    worlds = [(setting("supply_sag", share=share),) for share in (0.0, 0.5, 1.0)]
    supply = np.repeat((volts / SUPPLY_V)[None, :, None], 3, axis=0)
    played = rollout(scene, np.repeat(commands[None], 3, 0), *at_rest(scene, 3), worlds, supply=supply)
    none, half, whole = played.readings["joint_position"][..., 0]
    np.testing.assert_allclose(whole, sagging, atol=1e-12)
    assert np.array_equal(none, follow(scene, commands))
    assert np.abs(sagging - none).max() > 0.05
    assert 0 < np.abs(half - none).mean() < np.abs(whole - none).mean()


def test_the_voltage_of_a_motor_follows_its_supply_and_its_back_emf_does_not(pendulum):
    """A steady supply of 0.8 is a weaker `drive_voltage` and a softer servo, with the same slope."""
    commands, half = excitation(8), setting("drive_voltage", voltage_scale=0.5)
    supply = np.full((1, len(commands), 1), 0.8)
    weak = rollout(
        pendulum, commands[None], *at_rest(pendulum, 1), [(half, setting("supply_sag", share=1.0))], supply=supply
    ).readings["joint_position"][0, :, 0]
    same = follow(pendulum, commands, setting("drive_voltage", voltage_scale=0.4), setting("servo_gain", kp_scale=0.8))
    np.testing.assert_allclose(weak, same, atol=1e-12)
    assert np.abs(weak - follow(pendulum, commands, half)).max() > 0.01
