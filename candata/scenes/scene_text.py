"""A first `scene.yaml` of a model, as text with comments that say what each key means."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Sequence
from pathlib import Path

from candata.scenes.proposal import Proposal
from candata.schema.scene import Servo
from candata.schema.text_bounds import TextError
from candata.schema.yaml_text import parse_yaml

_WIDTH = 110
_NOISE = """\
# Noise of your sensors, one standard deviation each: uncomment it and fill it in, if you know it. Without it the noise
# is measured where the same commands were recorded more than once, else assumed from quiet stretches.
# noise:
#   object_pose: [0.001, 0.009]   # position [m], rotation [rad]
#   joint_position: 0.002         # [rad], of slides [m]; one number, or a list of one a joint
#   fingertip_force: 0.02         # [N]
#   force_step: 0.05              # quantisation of the force sensors [N]
"""


def scene_text(proposal: Proposal, model: str) -> str:
    """Return the text of a scene file with proposed roles, whose model is at `model` from there."""
    comment = f"Drafted by `candata scene init` from {Path(model).name}: check every line, then `candata scene show`."
    parts = [
        f"{_comment(comment)}\nmodel: {quote_word(model)}",
        _rate(proposal),
        _joints(proposal),
        _actuators(proposal),
        _fingertips(proposal),
        _object(proposal),
        _support(proposal),
        _groups(proposal),
        _NOISE.rstrip("\n"),
    ]
    return "\n\n".join(parts) + "\n"


def quote_word(name: str) -> str:
    """Return a name as YAML: as it is where that is read as the same text, else in quotes."""
    try:
        is_plain = parse_yaml(f"[{name}]") == [name] and "#" not in name and name == name.strip()
    except TextError:
        is_plain = False
    return name if is_plain else json.dumps(name, ensure_ascii=not name.isprintable())


def _comment(text: str) -> str:
    """Return text as comment lines."""
    return "\n".join(textwrap.wrap(text, _WIDTH, initial_indent="# ", subsequent_indent="# ", break_on_hyphens=False))


def _names_text(key: str, names: Sequence[str], indent: str = "") -> str:
    """Return a key with a list of names, in as many lines as they need."""
    begin = f"{indent}{key}: ["
    lines, line = [], begin
    for position, name in enumerate(names):
        piece = quote_word(name) + ("]" if position + 1 == len(names) else ", ")
        if len(line) + len(piece) > _WIDTH and line.strip() and line != begin:
            lines.append(line.rstrip())
            line = f"{indent}  "
        line += piece
    return "\n".join([*lines, line if names else f"{begin}]"])


def _rate(proposal: Proposal) -> str:
    """Return the part on the rate."""
    rates = ", ".join(f"{rate:g}" for rate in proposal.rates_hz)
    comment = "Rate of your commands and recordings [Hz]. A step of it holds a whole number of physics steps of"
    return f"{_comment(f'{comment} {proposal.timestep_s:g} s: {rates} do.')}\nrate_hz: {proposal.rate_hz:g}"


def _joints(proposal: Proposal) -> str:
    """Return the part on joints."""
    lines = ["# Joints whose positions are recorded, in the order of `joint_position`: hinges [rad] and slides [m]."]
    if proposal.other_joints:
        lines.append(_comment(f"Nothing drives these; add those that are recorded: {', '.join(proposal.other_joints)}"))
    lines += [_comment(note) for note in proposal.notes if "joint" in note]
    return "\n".join([*lines, _names_text("joints", proposal.joints)])


def _actuators(proposal: Proposal) -> str:
    """Return the part on actuators: those of the model, or guessed gains where it has none."""
    notes = [_comment(note) for note in proposal.notes if "actuator" in note]
    if not proposal.servos:
        comment = "# Actuators, in the order of `action`: what each takes is what is recorded as its command."
        return "\n".join([comment, *notes, _names_text("actuators", proposal.actuators)])
    comment = (
        "THE GAINS ARE GUESSED: the model has no actuators. Fill in those of your drives: stiffness kp [N m/rad] and "
        "damping kv [N m s/rad] of the position servo, and the largest torque `limit` [N m] (of slides N/m, N s/m, N). "
        "Leave joints out that no motor drives. `action` is the target position of each, in this order."
    )
    lines = [_comment(comment), "actuators:"]
    return "\n".join([*lines, *(f"  {quote_word(name)}: {_gains(servo)}" for name, servo in proposal.servos.items())])


def _gains(servo: Servo) -> str:
    """Return the gains of a servo as YAML."""
    values = {"kp": servo.kp, "kv": servo.kv, "limit": servo.limit}
    return "{" + ", ".join(f"{key}: {value:g}" for key, value in values.items() if value is not None) + "}"


def _fingertips(proposal: Proposal) -> str:
    """Return the part on fingertips and their frames."""
    comment = (
        "Fingertips with a force sensor, in the order of `fingertip_force` [N]: bodies (with all that they carry) or "
        "geoms. Leave out those without one. Forces are in the frame of the body, or of a site where one is named."
    )
    lines = [_comment(comment)]
    if proposal.other_tips:
        lines.append(_comment(f"Other ends of chains: {', '.join(proposal.other_tips)}"))
    lines.append(_names_text("fingertips", proposal.fingertips))
    comment_lines = _names_text("fingertip_frames", proposal.fingertip_frames or ("SITE",) * len(proposal.fingertips))
    return "\n".join([*lines, *(f"# {line}" for line in comment_lines.splitlines())])


def _object(proposal: Proposal) -> str:
    """Return the part on the object."""
    comment = ["Body with a free joint whose pose is tracked: `object_pose`, position [m] and quaternion w x y z."]
    comment += [note for note in proposal.notes if "free bod" in note]
    if proposal.other_objects:
        comment.append(f"Several bodies are free: this one seems the likeliest of {', '.join(proposal.free_bodies)}.")
    if proposal.floating_base and proposal.object == proposal.floating_base:
        comment.append(
            "It is the floating base of the robot: record its pose, or hold it in the model and leave it out."
        )
    elif proposal.floating_base:
        comment.append(
            f"The base of the robot, {proposal.floating_base}, floats: hold it in the model where yours is held."
        )
    if proposal.object is None:
        comment.append("No body of the model is free: leave it out for a robot alone.")
    key = f"object: {quote_word(proposal.object)}" if proposal.object else "# object: BODY"
    return "\n".join([*map(_comment, comment), key])


def _support(proposal: Proposal) -> str:
    """Return the part on the support."""
    free_geoms = proposal.object in (None, proposal.floating_base)
    no_support = "" if proposal.support or free_geoms else " Nothing that has a name lies below the object."
    key = f"support: {quote_word(proposal.support)}" if proposal.support else "# support: GEOM"
    return f"{_comment(f'Geom that the object rests on, such as a table.{no_support}')}\n{key}"


def _groups(proposal: Proposal) -> str:
    """Return the part on groups."""
    comment = _comment("Joints that may be at fault together: fingers, a wrist. The diagnosis looks at each group too.")
    if not proposal.groups:
        return f"{comment}\n# groups:\n#   index: [JOINT, JOINT]"
    members = (_names_text(quote_word(name), joints, "  ") for name, joints in proposal.groups.items())
    return "\n".join([comment, "groups:", *members])
