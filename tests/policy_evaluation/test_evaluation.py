"""Whole evaluations: which world is best, what effects explain, what to record next, and what is refused."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import dataclass, replace

import numpy as np
import pytest
from typer.testing import CliRunner

from candata.datasets import append, create_dataset, open_dataset
from candata.errors import UnknownNameError, UsageError
from candata.loaders import make_split, save_split
from candata.policies import read_motions
from candata.policy_evaluation import evaluation as evaluation_module
from candata.policy_evaluation import worlds as worlds_module
from candata.policy_evaluation.attribution import effect_share
from candata.policy_evaluation.evaluation import PolicyEvaluationSettings, evaluate_policies
from candata.policy_evaluation.policies import read_policies
from candata.policy_evaluation.seen import Withheld, recorded_success, recordings_from, withheld_effects
from candata.policy_evaluation.simulated import SimulatedWorld
from candata.policy_evaluation.worlds import ModelSettings
from candata.reports.policy_evaluation import NEXT_MOTION, ranking_figure, summary, write_policy_evaluation
from candata.schema.effect import EffectSetting
from candata.schema.episode import Episode
from candata.schema.manifest import Lineage
from candata_cli.main import build

SLIPPERY = EffectSetting(name="sliding_friction", parameters={"scale": 0.3})
LATE = EffectSetting(name="actuation_delay", parameters={"delay_s": 0.02})
SETTINGS = PolicyEvaluationSettings(group="all", starts=3, duration_s=1.6)
GRASP, PUSH = {"name": "grasp", "source": "grasp_lift_shake"}, {"name": "push", "source": "push"}
SHAKY = {"name": "shaky", "source": "grasp_lift_shake", "noise_share": 0.1}


@pytest.fixture(scope="module")
def found(recorded, tmp_path_factory):
    """Grasps that slip in the withheld world, which the repaired simulator knows and the nominal one does not."""
    path = tmp_path_factory.mktemp("policies") / "policies.yaml"
    path.write_text(json.dumps([GRASP, SHAKY, PUSH]))
    settings = replace(SETTINGS, effects=(SLIPPERY, LATE), withheld=Withheld((SLIPPERY,)))
    return evaluate_policies([], recorded, path, settings)


@pytest.fixture(scope="module")
def written(found, tmp_path_factory):
    """The folder with the page, the record and the next motion."""
    folder = tmp_path_factory.mktemp("page")
    write_policy_evaluation(*found, folder)
    return folder


def test_the_world_that_knows_the_effect_predicts_best(found):
    evaluation, _ = found
    rankings = {ranking.world: ranking for ranking in evaluation.rankings}
    assert list(rankings) == ["nominal", "repaired"]
    assert rankings["repaired"].mean_error < rankings["nominal"].mean_error
    assert rankings["nominal"].bias > 0.3
    assert evaluation.best == "repaired"
    assert evaluation.headline.startswith("repaired predicts policies best")
    assert evaluation.seen == "withheld"


def test_wrong_predictions_are_explained_by_the_effect_that_acts(found):
    shares = {entry.effect: entry for entry in found[0].effects}
    assert shares["sliding_friction"].wrong > 0
    assert shares["sliding_friction"].share > 0.7
    assert shares["actuation_delay"].explained < shares["sliding_friction"].explained / 2


def test_the_motion_to_record_next_is_where_worlds_disagree_and_can_be_played(found, written, gripper):
    evaluation, exhibit = found
    choice = evaluation.next_motion
    assert choice.outcomes["nominal"] != choice.outcomes["repaired"]
    assert choice.distance_m > 0
    (motion,) = read_motions(written / NEXT_MOTION, gripper).motions
    np.testing.assert_allclose(motion.commands, exhibit.motion.commands)
    assert motion.commands.shape[0] == round(1.6 * gripper.file.rate_hz)
    assert motion.name == f"{choice.policy} from {choice.start}"


def test_the_page_and_the_summary_say_first_which_world_is_best(found, written):
    evaluation, _ = found
    assert summary(evaluation).splitlines()[0] == evaluation.headline
    text = (written / "policies.html").read_text()
    assert evaluation.headline in text
    assert text.index("Predicted and seen") < text.index("The worst disagreement")
    assert text.count("<img") == 5 * 3  # nominal, repaired, withheld
    assert NEXT_MOTION in text


def test_a_motion_that_an_earlier_evaluation_proposed_goes(found, tmp_path):
    write_policy_evaluation(*found, tmp_path)
    assert (tmp_path / NEXT_MOTION).is_file()
    write_policy_evaluation(found[0].model_copy(update={"next_motion": None}), None, tmp_path)
    assert not (tmp_path / NEXT_MOTION).exists()


def test_no_mark_of_the_ranking_hides_another(found):
    evaluation, _ = found
    figure = str(ranking_figure(evaluation))
    dots = re.findall(r'<path d="M(\d+) (\d+)h0"><title>([^:]*): \d+ % in (\w+), (\d+) %', figure)
    assert len({int(x) for x, _, _, _, _ in dots}) == len(dots) == 3 * 2
    order = [int(seen) for _, _, _, _, seen in sorted(dots, key=lambda dot: int(dot[0]))]
    assert order == sorted(order)  # to the right more success was seen


def test_recordings_of_a_policy_count_for_its_name_and_start(recorded, gripper, starts, policies):
    chosen = read_policies(policies({**GRASP, "name": "grasp_lift_shake"}, PUSH), gripper)
    success = recorded_success(recorded, chosen, starts)
    assert success[0].tolist() == [1.0] * len(starts)
    assert np.isnan(success[1]).all()


def labelled(episode, start) -> Episode:
    return Episode(episode.meta.model_copy(update={"labels": {"start": start}}), dict(episode.arrays))


def test_a_label_of_a_start_that_is_none_is_refused_with_the_nearest(recorded, gripper, starts, policies, tmp_path):
    folder = create_dataset(tmp_path / "typo")
    shutil.copytree(recorded.path / "objects", folder / "objects", dirs_exist_ok=True)
    first, second = recorded.episodes(recorded.ids[:2])
    append(folder, [first, labelled(second, first.meta.id + "x")], Lineage(operation="test"))
    chosen = read_policies(policies({**GRASP, "name": "grasp_lift_shake"}), gripper)
    with pytest.raises(UnknownNameError, match=f"did you mean '{first.meta.id}'") as refused:
        recorded_success(open_dataset(folder), chosen, starts)
    assert second.meta.id in str(refused.value)


def test_recordings_that_were_played_from_a_start_are_told_by_their_label(recorded, tmp_path):
    folder = create_dataset(tmp_path / "again")
    shutil.copytree(recorded.path / "objects", folder / "objects", dirs_exist_ok=True)
    first, second = recorded.ids[:2]
    episodes = list(recorded.episodes((first, second)))
    append(folder, [episodes[0], labelled(episodes[1], first)], Lineage(operation="test"))
    assert recordings_from(open_dataset(folder), (first,)) == {second: first}
    assert recordings_from(open_dataset(folder), (second,)) == {}


def test_without_anything_seen_the_repaired_world_is_the_measure_and_none_is_judged(recorded, policies):
    settings = replace(SETTINGS, starts=2, effects=(SLIPPERY,))
    evaluation, _ = evaluate_policies([], recorded, policies(GRASP, PUSH), settings)
    assert evaluation.rankings == ()
    assert evaluation.headline.startswith("No world can be judged")
    assert evaluation.compared_with == "repaired"
    assert evaluation.effects[0].share == 1


def test_recordings_are_what_was_seen(recorded, policies):
    file = policies({**GRASP, "name": "grasp_lift_shake"}, PUSH)
    evaluation, _ = evaluate_policies([], recorded, file, replace(SETTINGS, starts=2))
    (ranking,) = evaluation.rankings
    assert (evaluation.seen, ranking.policies, ranking.agreement) == ("recordings", 1, 1.0)
    assert evaluation.headline == "No world can be ranked: one policy alone was seen"
    assert any("their `outcome`" in note and "within 1.6 s" in note for note in evaluation.notes)


@dataclass(frozen=True)
class Unstable(SimulatedWorld):
    """A world in which every simulation from the first start becomes unstable."""

    def play(self, policy, starts, seed, duration_s):
        made = super().play(policy, starts, seed, duration_s)
        return replace(made, failed=np.arange(len(starts)) == 0)


def test_what_became_unstable_in_the_stand_in_was_not_seen(recorded, policies, monkeypatch):
    monkeypatch.setattr(evaluation_module, "SimulatedWorld", Unstable)
    settings = replace(SETTINGS, starts=2, duration_s=0.5, goal="lift", withheld=Withheld((SLIPPERY,)))
    evaluation, _ = evaluate_policies([], recorded, policies(GRASP, PUSH), settings)
    assert [ranking.pairs for ranking in evaluation.rankings] == [2]  # the other start of two policies
    assert "2 simulations of withheld became unstable and count for nothing" in evaluation.notes
    assert evaluation.headline == "No world can be ranked: all policies succeed alike as they were seen"


def test_what_became_unstable_in_a_world_that_predicts_counts_for_nothing_and_is_said(recorded, policies, monkeypatch):
    monkeypatch.setattr(worlds_module, "SimulatedWorld", Unstable)
    settings = replace(SETTINGS, starts=2, duration_s=0.5, goal="lift")
    file = policies({**GRASP, "name": "grasp_lift_shake"})
    evaluation, _ = evaluate_policies([], recorded, file, settings)
    predicted, _ = evaluation.scores
    assert (predicted.total, predicted.unstable, sum(predicted.outcomes.values())) == (1, 1, 1)
    assert [ranking.pairs for ranking in evaluation.rankings] == [1]
    assert "1 simulations of nominal became unstable and count for nothing" in summary(evaluation)
    only = evaluate_policies([], recorded, file, replace(settings, starts=1))[0]
    assert (only.scores[0].total, only.rankings) == (0, ())
    assert "unstable 1" in write_policy_evaluation(only, None, file.parent).read_text()


def test_an_effect_explains_what_is_wrong_without_it_and_breaks_what_is_right_without_it():
    seen = np.array([[0.0, 0.0, 1.0, np.nan]])
    nominal, repaired = np.array([[1.0, 1.0, 1.0, 1.0]]), np.array([[0.0, 0.0, 0.0, 0.0]])
    share = effect_share("e", seen, nominal, repaired, np.array([[1.0, 0.0, 1.0, 1.0]]))
    assert (share.explained, share.wrong, share.broken, share.share) == (1, 2, 1, 0.5)
    unstable = np.where([[True, False, False, False]], np.nan, nominal)
    assert effect_share("e", seen, unstable, repaired, nominal).wrong == 1
    halves = np.full((1, 4), 0.5)  # repeats that ended either way make no prediction wrong
    assert effect_share("e", halves, nominal, repaired, repaired).wrong == 0


def test_a_policy_without_a_goal_is_asked_for_one(recorded, policies, tmp_path):
    (tmp_path / "still.py").write_text("def still(scene, rng):\n    return lambda observation: observation.action\n")
    file = policies({"name": "still", "source": "still.py:still"})
    settings = replace(SETTINGS, starts=2, duration_s=0.3)
    with pytest.raises(UsageError, match="does not say what is meant"):
        evaluate_policies([], recorded, file, settings)
    evaluation, _ = evaluate_policies([], recorded, file, replace(settings, goal="lift"))
    assert evaluation.scores[0].outcomes == {"miss": 2}
    assert evaluation.policies["still"].kind == "closed loop"


def test_an_unknown_origin_of_joints_is_refused_without_a_run_too():
    with pytest.raises(UnknownNameError, match="origin of joints"):
        ModelSettings(joints="motor")


def test_a_seal_of_another_scene_is_refused(gripper):
    with pytest.raises(UsageError, match="the seal is of another scene"):
        Withheld((SLIPPERY,), "0" * 64).check(gripper)


def test_the_command_prints_the_first_line_and_writes_the_page(recorded, policies, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hidden.yaml").write_text("effects: [{name: sliding_friction, parameters: {scale: 0.3}}]")
    assert withheld_effects(tmp_path / "hidden.yaml").effects == (SLIPPERY,)
    words = ["policy", "evaluate", "gripper_tabletop", str(recorded.path), "--policies", str(policies(GRASP, PUSH))]
    options = ["--withheld", "hidden.yaml", "--split", "all", "--starts", "2", "--duration-s", "1.6", "--out", "page"]
    result = CliRunner().invoke(build(), [*words, *options])
    assert result.exit_code == 0, result.output
    assert "predicts policies best" in result.stdout.splitlines()[0] or "can be ranked" in result.stdout.splitlines()[0]
    kept = json.loads((tmp_path / "page" / "policies.json").read_text())
    assert kept["worlds"].keys() == {"nominal", "withheld"}
    assert (tmp_path / "page" / "policies.html").is_file()


def test_a_run_is_a_world_and_one_that_was_trained_on_the_starts_is_refused(recorded, policies, tmp_path):
    pytest.importorskip("torch")
    from candata.training.jobs import TrainRequest, prepare
    from candata.training.loop import train
    from candata.training.settings import TrainingSettings

    settings = TrainingSettings(steps=2, batch=8)
    request = TrainRequest("mlp", config={"width": 16, "layers": 1}, history=3, horizon=4)
    data = open_dataset(shutil.copytree(recorded.path, tmp_path / "data"))
    save_split(data, make_split(data, {"train": 0.5, "val": 0.1, "test": 0.4}), "half")
    train(prepare(data, replace(request, split="half"), settings), tmp_path / "first")
    file = policies(GRASP)
    evaluation, _ = evaluate_policies([tmp_path / "first"], data, file, replace(SETTINGS, group="test", starts=2))
    assert list(evaluation.worlds) == ["nominal", "first"]
    assert "joints by a servo lag" in evaluation.worlds["first"]
    assert any("first forecasts no contact" in note for note in evaluation.notes)
    assert not any("was trained on" in note for note in evaluation.notes)
    knowing, _ = evaluate_policies([tmp_path / "first"], data, file, replace(SETTINGS, group="train", starts=2))
    assert any("first was trained on 2 of the 2 starts" in note for note in knowing.notes)
    other = create_dataset(tmp_path / "other")
    renamed = (
        Episode(episode.meta.model_copy(update={"id": f"o{k}"}), dict(episode.arrays))
        for k, episode in enumerate(recorded.episodes(recorded.ids[:3]))
    )
    shutil.copytree(recorded.path / "objects", other / "objects", dirs_exist_ok=True)
    append(other, renamed, Lineage(operation="test"))
    tuned = TrainRequest(init=tmp_path / "first")
    train(prepare(open_dataset(other), tuned, settings), tmp_path / "tuned")
    save_split(data, make_split(data, {"train": 0.1, "val": 0.1, "test": 0.8}, seed=4), "default")
    with pytest.raises(UsageError, match="tuned was trained on episodes of the group test"):
        evaluate_policies([tmp_path / "tuned"], data, file, replace(SETTINGS, group="test"))
