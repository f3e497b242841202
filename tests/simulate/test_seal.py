"""A withheld effect is in no byte of the dataset, and the seal proves what it was."""

from __future__ import annotations

import hashlib
import json
import stat

import numpy as np
import pyarrow.parquet as pq
import pytest
import trimesh

from candata.datasets import open_dataset, pending_parts
from candata.effects import effect, effect_names, flatten
from candata.errors import DataError, UnknownNameError, UsageError
from candata.scenes import load_scene
from candata.scenes.object_making import ObjectSource, make_object
from candata.schema.randomisation import RandomisationFile
from candata.simulate import open_seal
from candata.simulate.generate import Withheld, generate
from candata.simulate.seal import draw, read_seal

SALT = hashlib.sha256(b"a salt for tests").hexdigest()
SHORT = {"scene": "xhand_tabletop", "episodes": 3, "seed": 424242, "duration_s": 0.2, "workers": 1}
#: Several effects; with this salt all are drawn.
WORLD = RandomisationFile.model_validate(
    {
        "effects": [
            {"name": "servo_gain", "parameters": {"kp_scale": {"uniform": [0.5, 0.8]}}},
            {
                "name": "joint_dry_friction",
                "element": "index2",
                "parameters": {"frictionloss_Nm": {"uniform": [0, 0.1]}},
            },
            {"name": "pose_latency", "share": 0.5, "parameters": {"latency_s": {"normal": [0.03, 0.01]}}},
        ]
    }
)


@pytest.fixture(scope="module")
def hand():
    return load_scene("xhand_tabletop")


def withhold(tmp_path, asked="servo_gain", **change):
    hidden = Withheld(asked, tmp_path / "set.seal.json", change.pop("salt", SALT))
    return generate(tmp_path / "set", **{**SHORT, **change}, withheld=hidden)


def readable(folder) -> dict[str, bytes]:
    """Every file's bytes; a table's cells and metadata as text, too."""
    found = {}
    for path in (p for p in folder.rglob("*") if p.is_file()):
        found[str(path)] = path.read_bytes()
        if path.suffix == ".parquet":
            table = pq.read_table(path)
            text = [str(table.schema), str(pq.read_metadata(path).metadata)]
            text += [str(c.to_pylist()) for c in table.columns if "list" not in str(c.type)]
            found[f"{path} decoded"] = "\n".join(text).encode()
    return found


@pytest.mark.parametrize("asked", ["servo_gain", "any", WORLD])
def test_no_byte_of_the_dataset_tells_the_effect(tmp_path, asked):
    withhold(tmp_path, asked)
    seal = read_seal(tmp_path / "set.seal.json")
    open_dataset(tmp_path / "set").catalog()
    secrets = [seal.salt, bytes.fromhex(seal.salt).hex(":"), seal.label, str(seal.seed), str(seal.stream)]
    for withheld in seal.effects:
        secrets += [withheld.name, *withheld.parameters, *map(str, withheld.parameters.values())]
    secrets += ["withhold", "--seed", "randomisation"]
    for place, content in readable(tmp_path / "set").items():
        for secret in secrets:
            assert secret.encode() not in content, f"{secret} in {place}"
        assert bytes.fromhex(seal.salt) not in content


def test_the_lineage_keeps_the_commitment_only(tmp_path):
    version = withhold(tmp_path)
    seal = read_seal(tmp_path / "set.seal.json")
    (step,) = version.lineage
    expected = hashlib.sha256(seal.label.encode() + bytes.fromhex(seal.salt)).hexdigest()
    assert step.sealed == expected == seal.sealed
    assert step.seeds == ()
    assert set(step.details) == {"scene", "scene_digest", "policies", "duration_s", "noise"}
    (part,) = (tmp_path / "set" / "parts").iterdir()
    producer = json.loads((part / "part.json").read_text())["producer"]
    assert producer == {"operation": "generate-sim", "config": step.config_digest}


def test_episodes_have_plain_ids_and_neither_seed_nor_effects(tmp_path):
    withhold(tmp_path)
    data = open_dataset(tmp_path / "set")
    assert data.ids == ("withheld-000000", "withheld-000001", "withheld-000002")
    assert {(e.meta.seed, e.meta.effects) for e in data} == {(None, None)}


def test_the_sealed_file_is_for_its_owner(tmp_path):
    withhold(tmp_path)
    assert stat.S_IMODE((tmp_path / "set.seal.json").stat().st_mode) == 0o600


def test_the_seal_opens_on_its_dataset(tmp_path):
    withhold(tmp_path)
    (truth,) = open_seal(tmp_path / "set.seal.json", open_dataset(tmp_path / "set"))
    assert truth.name == "servo_gain"
    scale = truth.parameters["kp_scale"]
    assert 0.5 <= scale <= 0.8 or 1.3 <= scale <= 2.0


def test_a_seal_that_was_changed_does_not_open(tmp_path):
    withhold(tmp_path)
    path = tmp_path / "set.seal.json"
    path.write_text(path.read_text().replace("servo_gain", "joint_damp"))
    with pytest.raises(DataError, match="the seal does not fit the dataset"):
        open_seal(path, open_dataset(tmp_path / "set"))


def test_a_sealed_label_that_is_damaged_is_one_clear_error(hand):
    drawn = draw(hand, "any", 1, "0" * 64)
    with pytest.raises(UsageError, match="the sealed label is damaged"):
        _ = drawn.model_copy(update={"label": drawn.label[:-3]}).effects


def test_the_effect_is_applied(tmp_path):
    withhold(tmp_path, salt=None)
    seal = read_seal(tmp_path / "set.seal.json")
    plain = generate(tmp_path / "plain", **{**SHORT, "seed": seal.stream})
    assert len(plain.parts) == 1
    real, nominal = (next(iter(open_dataset(tmp_path / name))) for name in ("set", "plain"))
    assert np.array_equal(real["action"], nominal["action"])
    assert not np.array_equal(real["joint_position"], nominal["joint_position"])
    same = generate(tmp_path / "same", **{**SHORT, "seed": seal.stream}, effects=seal.effects)
    again = next(iter(open_dataset(tmp_path / "same")))
    assert same.number == 1
    assert np.array_equal(real["joint_position"], again["joint_position"])


def test_a_world_of_several_effects_is_drawn_once_for_the_whole_set(tmp_path, hand):
    withhold(tmp_path, WORLD)
    data = open_dataset(tmp_path / "set")
    truth = open_seal(tmp_path / "set.seal.json", data)
    names = [effect.name for effect in WORLD.effects]
    assert [effect.name for effect in truth] in (names, names[:2])
    assert 0.5 <= truth[0].parameters["kp_scale"] <= 0.8
    stream = read_seal(tmp_path / "set.seal.json").stream
    generate(tmp_path / "same", **{**SHORT, "seed": stream}, effects=truth)
    for real, again in zip(data, open_dataset(tmp_path / "same"), strict=True):
        assert np.array_equal(real["joint_position"], again["joint_position"])
    withhold(tmp_path, WORLD)  # the same again adds nothing
    assert len(open_dataset(tmp_path / "set")) == 3
    with pytest.raises(UsageError, match="the sealed file belongs to another set: its asked differs"):
        withhold(tmp_path, WORLD.model_copy(update={"effects": WORLD.effects[:2]}))


def test_seed_and_salt_decide_the_draw_of_a_world(hand):
    first = draw(hand, WORLD, 1, SALT)
    assert draw(hand, WORLD, 1, SALT) == first
    assert first.label not in {draw(hand, WORLD, 2, SALT).label, draw(hand, WORLD, 1, SALT[::-1]).label}
    assert {len(draw(hand, WORLD, seed, SALT).effects) for seed in range(20)} == {2, 3}


def test_a_stopped_run_keeps_its_draw(tmp_path):
    def stop(_count: int) -> None:
        if pending_parts(tmp_path / "set"):
            raise KeyboardInterrupt

    hidden = Withheld("any", tmp_path / "seal.json")
    with pytest.raises(KeyboardInterrupt):
        generate(tmp_path / "set", **{**SHORT, "episodes": 20}, withheld=hidden, progress=stop)
    before = (tmp_path / "seal.json").read_bytes()
    assert len(pending_parts(tmp_path / "set")) == 1
    told = []
    version = generate(tmp_path / "set", **{**SHORT, "episodes": 20}, withheld=hidden, progress=told.append)
    assert told == [16, 4]
    assert (tmp_path / "seal.json").read_bytes() == before
    salt = read_seal(tmp_path / "seal.json").salt
    fresh = Withheld("any", tmp_path / "fresh.json", salt)
    assert generate(tmp_path / "fresh", **{**SHORT, "episodes": 20}, withheld=fresh).digest == version.digest


@pytest.mark.parametrize(("change", "differs"), [({"asked": "armature"}, "asked"), ({"seed": 5}, "seed")])
def test_a_sealed_file_of_another_set_is_refused(tmp_path, change, differs):
    withhold(tmp_path)
    with pytest.raises(UsageError, match=f"the sealed file belongs to another set: its {differs} differs"):
        withhold(tmp_path, **change)


def test_a_dataset_without_its_sealed_file_is_refused(tmp_path):
    withhold(tmp_path)
    (tmp_path / "set.seal.json").unlink()
    with pytest.raises(UsageError, match="the dataset stands, its sealed file does not"):
        withhold(tmp_path)


def test_a_sealed_file_in_the_dataset_is_refused(tmp_path):
    with pytest.raises(UsageError, match="the sealed file would lie in the dataset"):
        generate(tmp_path / "set", **SHORT, withheld=Withheld("any", tmp_path / "set" / "seal.json"))
    assert not (tmp_path / "set").exists()


def test_known_and_withheld_effects_do_not_mix(tmp_path, hand):
    some = draw(hand, "armature", 1, SALT).effects
    with pytest.raises(UsageError, match="effects and a withheld effect at once"):
        generate(tmp_path / "set", **SHORT, effects=some, withheld=Withheld("any", tmp_path / "seal.json"))
    assert not (tmp_path / "seal.json").exists()


def test_wrong_names_are_refused(hand):
    with pytest.raises(UnknownNameError, match="servo_gain"):
        draw(hand, "servo_gains", 1, SALT)
    with pytest.raises(UsageError, match="effect armature cannot act in scene cube_toss"):
        draw(load_scene("cube_toss"), "armature", 1, SALT)
    with pytest.raises(UsageError, match="effect supply_sag cannot act in scene xhand_tabletop"):
        draw(hand, "supply_sag", 1, SALT)  # nothing recorded is followed in a simulation
    with pytest.raises(UsageError, match="not a salt"):
        draw(hand, "any", 1, "abcd")


def test_seed_and_salt_decide_the_draw_and_the_stream(hand):
    first = draw(hand, "any", 1, SALT)
    assert draw(hand, "any", 1, SALT) == first
    others = [draw(hand, "any", 2, SALT), draw(hand, "any", 1, SALT[::-1])]
    assert all(o.label != first.label and o.stream != first.stream for o in others)


def test_any_draws_every_possible_effect(hand):
    drawn = {draw(hand, "any", seed, SALT).effects[0].name for seed in range(500)}
    # A fair draw of 500 among 40 misses one with probability 40 (39/40)^500 < 1e-3; the seeds are fixed.
    assert drawn == {name for name in effect_names() if effect(name).possible(hand)}


@pytest.mark.parametrize("name", effect_names())
def test_a_draw_is_clearly_not_the_identity(hand, name):
    if not effect(name).possible(hand):
        pytest.skip("cannot act there")
    for seed in range(20):
        (given,) = draw(hand, name, seed, SALT).effects
        x = flatten(given, hand)
        identity = [(p.neutral or p.identity)(hand) for p in effect(name).parameters for _ in range(p.size(hand))]
        assert np.abs(x - identity).max() > 0.0
        for p in effect(name).parameters:
            if p.size(hand) > 1:
                reach = np.abs(np.array(p.draws(hand)) - p.identity(hand)).max()
                assert np.abs(x - p.identity(hand)).max() >= reach / 2


def test_what_is_withheld_acts_with_each_of_several_objects(tmp_path):
    mass = {"name": "object_mass", "parameters": {"mass_scale": {"uniform": [1.5, 2.0]}}}
    world = RandomisationFile.model_validate({"together": [1, 1], "effects": [mass]})
    trimesh.creation.box((0.05, 0.03, 0.02)).export(tmp_path / "block.stl")
    make_object(ObjectSource(tmp_path / "block.stl", "block", 0.1), tmp_path / "block", drops=20)
    withhold(tmp_path, world, scene="cube_toss", episodes=2, objects=("can", str(tmp_path / "block")))
    assert [e.meta.object for e in open_dataset(tmp_path / "set")] == ["can", "block"]
    assert [effect.name for effect in read_seal(tmp_path / "set.seal.json").effects] == ["object_mass"]
