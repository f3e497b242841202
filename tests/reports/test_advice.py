"""What to change, in words that name the amount, the place and the MJCF attribute."""

from __future__ import annotations

from pathlib import Path

import pytest

from candata.reports import advice
from candata.schema.report import Estimate, NamedEffect, RankedEffect


def named_effect(name: str, element: str | None = None, **values) -> NamedEffect:
    parameters = {
        k: Estimate(value=v) if not isinstance(v, list) else Estimate(value=v[0], low=v[1], high=v[2])
        for k, v in values.items()
    }
    return NamedEffect(name=name, element=element, share=1.0, support=1.0, parameters=parameters)


@pytest.mark.parametrize(
    ("effect", "instruction", "mjcf"),
    [
        (
            named_effect("joint_dry_friction", "index2", frictionloss_Nm=[0.0412, 0.0373, 0.0458]),
            "Add joint dry friction of 0.0412 N m (0.0373 to 0.0458) to joint index2",
            "add 0.0412 to frictionloss of the <joint>",
        ),
        (
            named_effect("joint_dry_friction", "index2", frictionloss_Nm=[0.0875, 0.0819, None]),
            "Add joint dry friction of 0.0875 N m (at least 0.0819; more explains as well) to joint index2",
            "add 0.0875 to frictionloss of the <joint>",
        ),
        (
            named_effect("contact_compliance", timeconst_s=[0.0304, 0.0298, 0.0305]),
            "Set the time constant of contacts at object, fingertips and support to 30.4 ms (29.8 to 30.5)",
            "0.0304 as the first number of solref of the <geom>s that touch, the second as it is",
        ),
        (
            named_effect("torque_limit", "ring1", limit_Nm=1.25),
            "Limit the torque of the servo of ring1 to 1.25 N m",
            'forcerange="-1.25 1.25" of the actuator',
        ),
        (named_effect("friction_cone", cone="elliptic"), "Use the elliptic friction cone", '<option cone="elliptic"/>'),
        (
            named_effect("object_com", offset_m=(0.01, 0.0, -0.002)),
            "Move the object's centre of mass by [10, 0, -2] mm, in its own frame",
            "add 0.01 0 -0.002 to pos of its <inertial>",
        ),
        (
            named_effect("link_mass", "forearm", mass_scale=[1.4, 1.37, 1.43]),
            "Multiply mass and inertia of link forearm by 1.4 (1.37 to 1.43)",
            "multiply mass or density of its <geom>s by 1.4, or mass and diaginertia of its <inertial>",
        ),
        (
            named_effect("joint_spring", "elbow", stiffness_Nm_rad=0.3, torque_Nm=-0.12),
            "Add a spring to joint elbow, with stiffness and torque at the joint's zero of 0.3 N m/rad and -0.12 N m",
            "add the first of 0.3 -0.12 to stiffness of the <joint>; springref is the second over the first",
        ),
        (named_effect("actuation_delay", delay_s=0.0125), "Delay the commands of every servo by 12.5 ms", ""),
    ],
)
def test_a_change_in_words(effect, instruction, mjcf):
    assert advice.change(effect) == advice.SimulatorChange(instruction, mjcf)


def test_what_mjcf_cannot_hold_is_added_by_the_effects_file():
    text = str(advice.change(named_effect("backlash", "index2", gap_rad=0.03)))
    assert text == f"Give the gears of joint index2 a play of 30 mrad; {advice.NO_ATTRIBUTE}."


@pytest.mark.parametrize(
    ("effect", "place"),
    [
        (
            named_effect("joint_dry_friction", "index", frictionloss_Nm=0.04),
            "to joints index1 and index2 (group index)",
        ),
        (named_effect("actuation_delay", "index", delay_s=0.01), "of the servos of index1 and index2 (group index)"),
    ],
)
def test_a_group_is_said_with_its_joints(effect, place):
    assert place in advice.change(effect, {"index": ("index1", "index2")}).instruction


def test_commands_name_the_files_from_where_the_reader_stands(make_report):
    context = advice.ReportContext(Path("out/my report"), mjcf_lines=('<joint name="index2"/>',))
    commands = [command for _, command in advice.commands(make_report(), context)]
    assert [command.split(" --effects ")[0] for command in commands] == ["candata generate-sim", "candata scene export"]
    assert all("--effects 'out/my report/effects.yaml' " in command for command in commands)
    assert advice.commands(make_report("ambiguous"), context) == [], "nothing is repaired"
    assert len(advice.commands(make_report(), advice.ReportContext())) == 1, "MJCF holds none of it"


def test_an_effect_without_words_is_said_by_its_name():
    text = advice.change(named_effect("learned_residual", "index2", gravity=0.03)).instruction
    assert text.startswith("Add learned residual on index2: ")
    assert text.endswith(", 0.03")
    assert "Add wind: 0.4 N" in advice.change(named_effect("wind", force_N=0.4)).instruction


def test_a_long_vector_stays_in_the_file():
    change = advice.change(named_effect("tactile_bias", bias_N=tuple([0.1] * 15)))
    assert "the 15 values of effects.yaml" in change.instruction


def test_what_could_not_be_tested_and_why(make_report):
    report = make_report()
    unresponsive = RankedEffect(name="rolling_friction", support=0, held_out_gain=0, reason=advice.NO_RESPONSE)
    blind = report.data.model_copy(update={"channels": ("joint_position", "object_pose")})
    report = report.model_copy(update={"ranking": (*report.ranking, unresponsive), "data": blind})
    rows = {reason: instruction for instruction, reason in advice.untested_effects(report)}
    assert rows["not tested: it moves nothing in these motions"] == "rolling friction"
    assert "tactile lag" in rows["fingertip force was not recorded"]
    assert "tactile gain" not in str(rows), "it was ranked"
    assert advice.missing_channels(report) == ["fingertip_force"]


def test_what_is_named_is_not_said_to_be_untested(make_report):
    """Beside the others it was tested, though alone it gained little."""
    report = make_report()
    candidate = RankedEffect(
        name=report.effects[0].name, support=0, held_out_gain=0, reason="gains little on the episodes looked at"
    )
    for effects, is_listed in (((), True), (report.effects, False)):
        changed_report = report.model_copy(update={"ranking": (candidate,), "effects": effects})
        assert (
            "gains little on the episodes looked at" in dict(map(reversed, advice.untested_effects(changed_report)))
        ) is is_listed


def test_too_few_episodes_say_how_many_are_missing(make_report):
    assert "record 3 more episodes" in advice.next_step(make_report("too_little_data"))
