"""Records refuse what they do not know, and say file and field."""

import pytest
from pydantic import ValidationError

from candata.errors import UsageError
from candata.schema.channels import CHANNELS, canonical_order
from candata.schema.effect import EffectsFile
from candata.schema.report import Estimate
from candata.schema.scene import SceneFile, TableMap
from candata.schema.topics import TopicMap
from candata.units import TO_SI

MAP = {"file": "t.csv", "time_s": "t", "rate_hz": 80, "channels": {"object_pose": list("abcdefg")}}
SCENE = {"model": "s.xml", "rate_hz": 80}


def refusal(record, value) -> str:
    with pytest.raises(UsageError) as caught:
        record.parse(value, "folder/map.yaml")
    return str(caught.value)


def test_a_record_is_frozen():
    record = TableMap.parse(MAP, "map.yaml")
    with pytest.raises(ValidationError, match="frozen"):
        record.file = "other"


def test_a_missing_field():
    text = refusal(TableMap, {k: v for k, v in MAP.items() if k != "time_s"})
    assert text.splitlines()[0] == "map.yaml is not valid: required key `time_s` is missing"
    assert text.splitlines()[-2:] == ["  where: folder/map.yaml", "  do: add `time_s`"]


def test_an_unknown_key_names_the_known_and_the_nearest():
    assert refusal(SceneFile, SCENE | {"suport": "table"}) == (
        "map.yaml is not valid: unknown key `suport`, did you mean `support`\n"
        "  expected: keys model, rate_hz, object, joints, actuators, fingertips, fingertip_frames, support, groups, "
        "noise, repeatability\n"
        "  found: 'table'\n"
        "  where: folder/map.yaml\n"
        "  do: rename or remove what is unknown"
    )
    assert refusal(SceneFile, SCENE | {"xyz": 1}).startswith("map.yaml is not valid: unknown key `xyz`\n")


def test_an_unknown_key_beside_a_missing_one_is_one_error():
    text = refusal(SceneFile, {"model": "s.xml", "rate": 80, "suport": "table"})
    assert text.splitlines()[0] == (
        "map.yaml is not valid: unknown key `rate`, did you mean `rate_hz`, which is required and missing; "
        "unknown key `suport`, did you mean `support`"
    )
    text = refusal(SceneFile, {"rate_hz": 80, "suport": "table"})
    assert text.splitlines()[0] == (
        "map.yaml is not valid: unknown key `suport`, did you mean `support`; required key `model` is missing"
    )
    assert text.endswith("\n  do: rename or remove what is unknown, and add `model`")


def test_a_file_of_another_kind_names_some_of_its_keys():
    first = refusal(SceneFile, MAP | {"episode": "e", "units": {}}).splitlines()[0]
    assert first.count("unknown key") == 5
    assert first.endswith("required key `model` is missing")
    assert "; 3 more unknown" in refusal(SceneFile, SCENE | {k: 1 for k in "abcdefgh"})


@pytest.mark.parametrize(
    ("record", "value", "said"),
    [
        (
            SceneFile,
            {"noise": {"joint_positon": 1}},
            "noise: unknown key `joint_positon`, did you mean `joint_position`",
        ),
        (SceneFile, {"actuators": {"a": {"kp": 3, "vk": 0}}}, "actuators.a: unknown key `vk`"),
        (
            SceneFile,
            {"actuators": {"a": {"kpp": 3}}},
            "actuators.a: unknown key `kpp`, did you mean `kp`, which is required and missing",
        ),
        (
            TopicMap,
            {"channels": {"object_pose": [{"topic": "a", "feilds": ["x"]}]}},
            "channels.object_pose.0: unknown key `feilds`, did you mean `fields`",
        ),
        (
            EffectsFile,
            {"effects": [{"name": "armature"}, {"name": "armature", "parameter": {}}]},
            "effects.1: unknown key `parameter`, did you mean `parameters`",
        ),
    ],
)
def test_an_unknown_key_inside_is_named_with_its_path(record, value, said):
    base = {SceneFile: SCENE, TopicMap: {"rate_hz": 10}, EffectsFile: {}}[record]
    assert refusal(record, base | value).splitlines()[0] == f"map.yaml is not valid: {said}"


@pytest.mark.parametrize(
    ("joints", "said", "do"),
    [
        (["a", 1], "joints.1: a name is text, and this is read as a number", 'put the name in quotes, as "1"'),
        ([1.5], "joints.0: a name is text, and this is read as a number", "put the name in quotes"),
        ([True], "joints.0: a name is text, and this is read as true or false", 'put the name in quotes, as "true"'),
        ([None], "joints.0: a name is text, and this is read as nothing", "put the name in quotes"),
        ("index1", "joints: a list is expected", "write it in brackets: [index1]"),
    ],
)
def test_a_name_that_is_read_as_something_else(joints, said, do):
    lines = refusal(SceneFile, SCENE | {"joints": joints}).splitlines()
    assert (lines[0], lines[-1]) == (f"map.yaml is not valid: {said}", f"  do: {do}")


def test_a_number_for_a_key():
    lines = refusal(SceneFile, SCENE | {"actuators": {1: {"kp": 3}}}).splitlines()
    assert lines[0] == "map.yaml is not valid: actuators.1: a name is text, and this is read as a number"


def test_of_a_field_with_two_forms_the_one_that_fits_is_told():
    text = refusal(SceneFile, SCENE | {"actuators": {"a": 3}})
    assert text.startswith("map.yaml is not valid: actuators.a: keys with values are expected\n  expected: keys kp, kv")
    text = refusal(SceneFile, SCENE | {"noise": {"joint_position": [0.1, -1]}})
    assert text.startswith("map.yaml is not valid: noise.joint_position.1: Input should be greater than or equal to 0")


@pytest.mark.parametrize(
    ("changed", "field"),
    [
        ({"rate_hz": 0}, "rate_hz"),
        ({"rate_hz": "fast"}, "rate_hz"),
        ({"source": "dream"}, "source"),
        ({"force": "peak"}, "force"),
        ({"action": "now"}, "action"),
        ({"channels": []}, "channels"),
    ],
)
def test_a_wrong_value_names_its_field(changed, field):
    text = refusal(TableMap, MAP | changed)
    assert text.startswith(f"map.yaml is not valid: {field}: ")
    assert text.endswith(f"do: correct the field {field}")


def test_a_file_that_is_no_mapping():
    text = refusal(TableMap, None)
    assert text.startswith(
        "map.yaml is not valid: (whole file): keys with values are expected\n  expected: keys file, "
    )


def test_a_nested_field_is_named_in_full():
    text = refusal(SceneFile, SCENE | {"noise": {"joint_position": -1}})
    assert "do: correct the field noise.joint_position" in text


def test_actuators_may_be_names_or_servos():
    base = {"model": "s.urdf", "rate_hz": 80}
    assert SceneFile.parse(base | {"actuators": ["a", "b"]}, "s").actuator_names == ("a", "b")
    assert SceneFile.parse(base | {"actuators": {"a": {"kp": 3}}}, "s").actuator_names == ("a",)


def test_an_effects_file_keeps_numbers_words_and_vectors():
    effects = EffectsFile.parse(
        {"effects": [{"name": "x", "parameters": {"a": 1.5, "b": "elliptic", "c": [1.0, 2.0]}}]}, "e"
    ).effects
    assert effects[0].parameters == {"a": 1.5, "b": "elliptic", "c": (1.0, 2.0)}


def test_channels_have_known_units_and_one_order():
    assert {row.unit for row in CHANNELS.values()} <= {*TO_SI, "joint"}
    names = ["contact", "object_pose_valid", "time_ns", "object_pose"]
    assert canonical_order(names) == ["time_ns", "object_pose", "object_pose_valid", "contact"]


def test_a_small_file_that_unfolds_without_end_is_refused_at_once():
    value = ["x"]
    for _ in range(60):  # what YAML's aliases make of 60 short lines: 9 ** 60 texts
        value = [value] * 9
    assert "unknown key `a`; required key `file` is missing" in refusal(TableMap, {"a": value})


@pytest.mark.parametrize(
    ("ends", "bounded"),
    [({"low": 1.0, "high": 2.0}, "both"), ({"low": 1.0}, "low"), ({"high": 2.0}, "high"), ({}, None)],
)
def test_an_estimate_says_which_of_its_ends_are_known(ends, bounded):
    estimate = Estimate(value=1.5, **ends)
    assert estimate.bounded == bounded
    assert Estimate.model_validate_json(estimate.model_dump_json()) == estimate


def test_an_estimate_whose_word_contradicts_its_ends_is_refused():
    text = refusal(Estimate, {"value": 1.5, "low": 1.0, "bounded": "both"})
    assert "bounded is 'both', but low and high say 'low'" in text
