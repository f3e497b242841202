"""Records refuse what they do not know, and say file and field."""

import pytest
from pydantic import ValidationError

from candata.errors import UsageError
from candata.schema.channels import CHANNELS, canonical_order
from candata.schema.effect import EffectsFile
from candata.schema.report import Estimate
from candata.schema.scene import SceneFile, TableMap
from candata.units import TO_SI

MAP = {"file": "t.csv", "time_s": "t", "rate_hz": 80, "channels": {"object_pose": list("abcdefg")}}


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
    assert text.splitlines()[0] == "map.yaml is not valid: time_s: Field required"
    assert text.splitlines()[-2:] == ["  where: folder/map.yaml", "  do: correct the field time_s"]


def test_an_unknown_field():
    text = refusal(TableMap, MAP | {"unit": {}})
    assert text.splitlines()[0] == "map.yaml is not valid: unit: Extra inputs are not permitted"


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
    assert refusal(TableMap, None).startswith("map.yaml is not valid: (whole file): ")


def test_a_nested_field_is_named_in_full():
    text = refusal(SceneFile, {"model": "s.xml", "rate_hz": 80, "noise": {"joint_position": -1}})
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
    assert "file: Field required" in refusal(TableMap, {"a": value})


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
