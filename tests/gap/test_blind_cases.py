"""Cases on disk: sealed first, readable by others, silent about their label, whole or absent; a killed run goes on."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from candata.datasets import open_dataset
from candata.errors import DataError, SceneError, UsageError
from candata.gap.blind import sanity
from candata.gap.blind.cases import CASE, CASES, make_cases, read_cases, scene_of
from candata.gap.blind.labels import LABELS, open_labels, read_labels, seal_labels
from candata.gap.blind.runs import CACHE, COLD_EACH, RESULTS, Answer, Place, finished, run_cases
from candata.gap.blind.sanity import check_scene
from candata.gap.blind.shares import measure_shares, true_shares
from candata.policies import policy
from candata.scenes import Scene, load_scene
from candata.schema.bench import CaseResult, Label
from candata.schema.effect import EffectSetting
from candata.schema.report import DiagnosisData, EpisodeCount, Report
from candata.statistics import noise_sd
from tests.gap.conftest import ARM, ROLES

SALT = "ab" * 32
SMALL = {"seed": 1, "episodes": 2, "duration_s": 0.4}
COUNTS = {"one": 2, "null": 2, "pair": 1}
SCENE = "cube_toss"


@pytest.fixture(scope="module")
def run(tmp_path_factory, cube):
    """A small run with its cases made."""
    out = tmp_path_factory.mktemp("blind")
    sealed = seal_labels(out, cube, COUNTS, salt=SALT, **SMALL)
    make_cases(out, SCENE, sealed, **SMALL)
    return out


def places(run):
    return [Place(p, SCENE, c.sealed) for p, c in read_cases(run / CASES).items()]


def silent(dataset, scene, seed, cache):
    """Find nothing."""
    counts = EpisodeCount(total=len(dataset), folds=0, held_out=0)
    return Answer(Report(verdict="no_gap", data=DiagnosisData(dataset=dataset.name, episodes=counts)))


def test_the_labels_are_for_the_owner_only(run):
    assert (run / LABELS).stat().st_mode & 0o777 == 0o600


def test_a_case_tells_nothing_of_its_label(run):
    labels = read_labels(run / LABELS)
    for path, case in read_cases(run / CASES).items():
        told = "\n".join(f.read_text() for f in path.rglob("*.json") if f.name != "dataset.json")
        hidden = json.loads(labels.labels[case.name])
        assert all(e["name"] not in told for e in hidden["effects"])
        assert str(hidden["seed"]) not in told
        assert all(e.meta.effects is None and e.meta.seed is None for e in open_dataset(path))
        assert set(json.loads((path / CASE).read_text())) == {"name", "scene", "scene_digest", "episodes", "sealed"}


def test_nulls_have_different_hashes(run):
    assert len({case.sealed for case in read_cases(run / CASES).values()}) == 5


def test_all_cases_share_their_commands_and_starts_but_not_their_noise(run, cube):
    nulls = [n for n, t in read_labels(run / LABELS).labels.items() if json.loads(t)["kind"] == "null"]
    first, other = (open_dataset(run / CASES / n).episode("episode-0000")["object_pose"] for n in nulls)
    assert (first != other).any()
    # The same throw: apart by noise of 0.5 mm in position, five of these and the root of two allowed.
    assert abs(first[:, :3] - other[:, :3]).max() < 5 * 1.5 * cube.file.noise.object_pose[0]


def test_the_labels_open_and_one_that_was_changed_does_not(run):
    cases, sealed = read_cases(run / CASES), read_labels(run / LABELS)
    assert sorted(one.kind for one in open_labels(cases, sealed).values()) == ["null", "null", "one", "one", "pair"]
    name = next(iter(sealed.labels))
    text = json.dumps({**json.loads(sealed.labels[name]), "kind": "null", "effects": []})
    with pytest.raises(DataError, match=f"the label of {name} is not the one"):
        open_labels(cases, sealed.model_copy(update={"labels": {**sealed.labels, name: text}}))
    with pytest.raises(DataError, match="no label"):
        open_labels(cases, sealed.model_copy(update={"labels": {}}))


def test_the_same_command_takes_what_stands_and_another_is_refused(run, cube):
    before = (run / LABELS).read_text()
    again = seal_labels(run, cube, COUNTS, **SMALL)
    assert make_cases(run, SCENE, again, told=lambda name: pytest.fail("made again"), **SMALL)
    assert (run / LABELS).read_text() == before
    with pytest.raises(UsageError, match="asked for something else") as caught:
        seal_labels(run, cube, COUNTS | {"one": 3}, **SMALL)
    assert "count_one 2" in str(caught.value)
    with pytest.raises(UsageError, match="drawn from another salt"):
        seal_labels(run, cube, COUNTS, salt="cd" * 32, **SMALL)


def test_a_random_salt_draws_other_cases_for_the_same_seed(tmp_path, cube):
    first, other = (seal_labels(tmp_path / n, cube, {"one": 6}, **SMALL) for n in ("a", "b"))
    assert first.salt != other.salt
    assert list(first.labels.values()) != list(other.labels.values())


def test_a_case_whose_making_was_cut_short_is_made_anew(tmp_path, cube):
    sealed = seal_labels(tmp_path, cube, {"null": 1}, **SMALL)
    (tmp_path / CASES / ".case-0001").mkdir(parents=True)
    (tmp_path / CASES / ".case-0001" / "rest").write_text("")
    (path,) = make_cases(tmp_path, SCENE, sealed, **SMALL)
    assert len(open_dataset(path)) == 2
    assert not (path / "rest").exists()


def test_a_killed_run_goes_on_where_it_stopped(run, tmp_path):
    heard: list[str] = []

    def killed(dataset, scene, seed, cache):
        if len(heard) == 2:
            raise KeyboardInterrupt
        return silent(dataset, scene, seed, cache)

    with pytest.raises(KeyboardInterrupt):
        run_cases(tmp_path, places(run), judge=killed, told=lambda r: heard.append(r.case))
    log = tmp_path / RESULTS
    log.write_text(log.read_text() + '{"case": "case-0')  # a line that the kill cut
    again: list[str] = []
    results = run_cases(tmp_path, places(run), judge=silent, told=lambda r: again.append(r.case))
    assert heard + again == [r.case for r in results] == [p.folder.name for p in places(run)]
    assert len(finished(log, CaseResult)) == 5
    assert [r.cold for r in results] == [True] + [False] * 4


def test_few_cases_are_diagnosed_with_nothing_kept_and_that_is_told(run, tmp_path):
    caches = []

    def noted(dataset, scene, seed, cache):
        caches.append(cache)
        return silent(dataset, scene, seed, cache)

    one = places(run)[0]
    many = [one._replace(sealed=str(i)) for i in range(2 * COLD_EACH)]
    results = run_cases(tmp_path, many, judge=noted)
    assert [r.cold for r in results] == [c is None for c in caches] == [True] * 2 + [False] * (2 * COLD_EACH - 2)
    assert set(caches[2:]) == {(tmp_path / CACHE).resolve()}


def test_results_of_other_cases_are_not_taken_for_these(run, tmp_path):
    run_cases(tmp_path, [p._replace(sealed=f"other {p.sealed}") for p in places(run)], judge=silent)
    heard: list[CaseResult] = []
    run_cases(tmp_path, places(run), judge=silent, told=heard.append)
    assert len(heard) == 5


def test_a_diagnosis_that_fails_is_a_result(run, tmp_path):
    def failing(dataset, scene, seed, cache):
        raise DataError("nothing to compare")

    (result,) = run_cases(tmp_path, places(run)[:1], judge=failing)
    assert (result.report, result.error) == (None, "nothing to compare")


def hearing(told, noise, dataset, scene, seed, cache):
    """Find nothing, and keep the scene that was told."""
    told[noise] = scene
    return silent(dataset, scene, seed, cache)


def test_noise_that_is_not_as_declared_is_in_the_recordings_and_a_diagnosis_is_not_told(tmp_path, cube):
    sizes, told = {}, {}
    for noise in ("declared", "misdeclared", "undeclared"):
        sealed = seal_labels(tmp_path / noise, cube, {"null": 1}, noise=noise, salt=SALT, **SMALL)
        (path,) = make_cases(tmp_path / noise, SCENE, sealed, **SMALL)
        (case,) = read_cases(path.parent).values()
        (label,) = open_labels({path: case}, sealed).values()
        pose = np.concatenate([e["object_pose"][:, :3] for e in open_dataset(path)])
        sizes[noise] = noise_sd(pose, 0, 0).mean() / label.noise_factor
        place = Place(path, SCENE, case.sealed, case.noise_declared)
        run_cases(tmp_path / noise, [place], judge=partial(hearing, told, noise))
    assert told["undeclared"].file.noise is None
    assert told["misdeclared"].file.noise == told["declared"].file.noise == cube.file.noise
    # Of some 60 rows each a spread is known to a tenth; a throw's own bend adds little.
    assert sizes["misdeclared"] == pytest.approx(sizes["declared"], rel=0.3)
    assert sizes["undeclared"] == pytest.approx(sizes["declared"], rel=0.3)


def test_noise_cannot_be_withheld_by_a_scene_that_declares_none(tmp_path, arm):
    silent_scene = replace(arm, file=arm.file.model_copy(update={"noise": None}))
    with pytest.raises(UsageError, match="declares no noise"):
        seal_labels(tmp_path, silent_scene, {"null": 1}, noise="undeclared", **SMALL)


def test_a_scene_file_is_found_from_its_case(tmp_path, run):
    path, case = next(iter(read_cases(run / CASES).items()))
    assert scene_of(path, case) == SCENE
    own = case.model_copy(update={"scene": "../../my/scene.yaml"})
    assert scene_of(tmp_path / "cases" / "case-0001", own) == str(tmp_path / "my" / "scene.yaml")


def test_no_cases_and_a_case_under_another_name_are_refused(tmp_path, run):
    with pytest.raises(UsageError, match="no cases"):
        read_cases(tmp_path)
    (tmp_path / "case-0007").mkdir()
    text = (run / CASES / "case-0001" / CASE).read_text()
    (tmp_path / "case-0007" / CASE).write_text(text)
    with pytest.raises(UsageError, match="another name"):
        read_cases(tmp_path)
    (tmp_path / "case-0007" / CASE).write_text(text[:-5])
    with pytest.raises(UsageError, match=r"case\.json is no JSON"):
        read_cases(tmp_path)


def test_what_is_taken_out_of_the_true_world_is_worth_its_size(arm, arm_episodes, as_dataset):
    strong = EffectSetting(name="servo_gain", parameters={"kp_scale": 0.5})
    faint = EffectSetting(name="servo_damping", parameters={"kv_scale": 1.0003})
    dataset = as_dataset(arm_episodes((strong, faint)))
    found = true_shares(dataset, arm, Label(case="c", kind="pair", effects=(strong, faint)))
    # Half the stiffness is far above the 1 mrad of the encoders; 0.03 % of damping lags by some 0.1 mrad.
    assert found.rises["servo_gain"] > 1 > 0.2 > abs(found.rises["servo_damping"])
    assert found.alike is not None
    assert 0 <= found.alike <= 1


def test_shares_are_measured_once_and_where_something_of_the_library_is_hidden(run, tmp_path):
    labels = open_labels(read_cases(run / CASES), read_labels(run / LABELS))
    heard: list[int] = []
    for _ in range(2):
        found = measure_shares(tmp_path, places(run), labels, told=heard.append)
    hiding = {name for name, one in labels.items() if one.effects}
    assert 1 < len(hiding) < len(labels)
    assert heard == [1] * len(hiding)
    assert set(found) == hiding
    for name in hiding:
        assert len(found[name].rises) == len(labels[name].effects)


def test_a_scene_is_checked_before_anything_is_hidden(cube):
    fit = check_scene(cube, seed=1, duration_s=0.4, only=("sliding_friction", "object_mass", "pose_bias"))
    assert fit.moving == 0
    # A cube in free flight on a rigid plane moves alike whatever its mass.
    assert fit.dead == ("object_mass",)
    assert set(fit.live) == {"sliding_friction", "pose_bias"}


def test_an_effect_that_cannot_be_simulated_is_not_drawn(cube, monkeypatch):
    true = sanity.tried_episodes

    def failing(scene, jobs, **options):
        made, fails = true(scene, jobs, **options)
        return made, np.where([j.effects[0].name == "pose_bias" for j in jobs], 0.1, fails)

    monkeypatch.setattr(sanity, "tried_episodes", failing)
    fit = check_scene(cube, seed=1, duration_s=0.4, only=("sliding_friction", "pose_bias"))
    assert (fit.live, fit.dead) == (("sliding_friction",), ("pose_bias",))


@pytest.mark.parametrize("seed", [96, 106])
def test_a_joint_that_only_command_noise_moves_is_not_asked_to_follow(hand, seed):
    """In these motions the noise of a finger's sideways joint, which no motion moves, spans 0.03 rad."""
    fit = check_scene(hand, seed=seed, duration_s=3.2, only=("pose_bias",))
    assert fit.moving >= 10
    assert fit.follows > 0.95


@pytest.mark.parametrize("gear", [1, -1, 2])
def test_a_scene_is_refused_where_a_joint_does_not_follow(tmp_path, gear):
    """A servo drives its joint to the command over the gear, which may be negative; an equality holds the joint."""
    free = ARM.replace('joint="elbow"', f'joint="elbow" gear="{gear}"')
    fit = check_scene(written(tmp_path / "fit", free), seed=1, duration_s=3.2, only=("joint_damping",))
    assert fit.moving == 2
    assert fit.follows > 0.85, "jumps at the motors' limits come late: 0.88 to 0.90"
    stuck = free.replace(
        "</worldbody>",
        '</worldbody><equality><joint joint1="elbow" solref=".004 1" solimp=".999 .9999 .001"/></equality>',
    )
    with pytest.raises(SceneError, match="at joint elbow"):
        check_scene(written(tmp_path / "stuck", stuck), seed=1, duration_s=3.2, only=("joint_damping",))


def test_motors_have_no_target_to_follow(tmp_path):
    motors = re.sub(
        r"<position (.*?) kp=.*?forcerange", r"<motor \1 ctrllimited='true' ctrlrange='-1 1' forcerange", ARM
    )
    assert motors.count("<motor") == 2
    scene = written(tmp_path, motors)
    fit = check_scene(scene, seed=1, duration_s=3.2, only=("joint_damping",))
    assert (fit.moving, fit.worst) == (0, "")
    # Nor do they jump: nothing would hold them back. A fifth of the range is what a motor is driven by, and noise.
    plan = policy("free_sweep").plan(scene, np.random.default_rng(1), 3.2)
    assert 0.1 < np.abs(plan.commands).max() < 0.25


def written(folder: Path, model: str) -> Scene:
    """The scene of an arm's model."""
    folder.mkdir(exist_ok=True)
    (folder / "arm.xml").write_text(model)
    (folder / "scene.yaml").write_text(ROLES)
    return load_scene(folder / "scene.yaml")
