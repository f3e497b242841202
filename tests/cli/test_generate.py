"""Commands generate-sim, scene, demo: what they print and how they end."""

from __future__ import annotations

import json
import re
from types import SimpleNamespace

import pytest

from candata.effects import effect
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting
from candata.schema.report import DiagnosisData, EpisodeCount, Estimate, NamedEffect, Report
from candata.simulate.randomisation import check_randomisation
from candata_cli import demo_command
from tests.cli.command import exit_code


@pytest.fixture
def toss(tmp_path):
    """Words of a small, quick set, and where it goes."""
    out = tmp_path / "set"
    words = ("generate-sim", "--scene", "cube_toss", "--episodes", 2, "--duration-s", 0.2, "--jobs", 1)
    return (*words, "--out", out), out


def test_generate_says_what_stands(toss, capsys):
    words, out = toss
    assert exit_code(*words, "--seed", 3) == 0
    first = capsys.readouterr()
    assert first.out.startswith(f"{out}: 2 episodes in version 1, digest ")
    assert first.err == "episodes: 2 done\n"
    assert exit_code(*words, "--seed", 3) == 0
    assert capsys.readouterr().out == first.out


def test_generated_sets_are_valid(toss, capsys):
    words, out = toss
    exit_code(*words)
    capsys.readouterr()
    assert exit_code("validate", out) == 0
    assert capsys.readouterr().out.startswith("2 episodes, no findings\n")


def test_a_withheld_effect_is_not_printed(toss, capsys):
    words, out = toss
    assert exit_code(*words, "--withhold", "object_mass", "--seed", 98765) == 0
    printed = capsys.readouterr()
    assert printed.err.endswith(f"withheld effect sealed in {out}.seal.json\n")
    seal = json.loads(out.with_name("set.seal.json").read_text())
    for secret in ("mass", "98765", seal["salt"]):
        assert secret not in printed.out + printed.err.replace(str(out), "")


def test_effects_come_from_a_file_that_may_name_the_scene(tmp_path, capsys):
    path = tmp_path / "effects.yaml"
    path.write_text("scene: cube_toss\neffects: [{name: object_mass, parameters: {mass_scale: 1.5}}]\n")
    words = (
        "generate-sim",
        "--episodes",
        1,
        "--duration-s",
        0.2,
        "--effects",
        path,
        "--out",
        tmp_path / "set",
    )
    assert exit_code(*words) == 0
    from candata.datasets import open_dataset

    (episode,) = open_dataset(tmp_path / "set")
    assert episode.meta.effects[0].parameters == {"mass_scale": 1.5}


@pytest.fixture
def randomised(tmp_path):
    """A function that draws the effects of two tosses as a file says, and the dataset."""

    def make(text: str, *words: object) -> int:
        path = tmp_path / "random.yaml"
        path.write_text(text)
        command = ("generate-sim", "--randomise", path, "--episodes", 2, "--duration-s", 0.2, "--jobs", 1)
        return exit_code(*command, *words, "--out", tmp_path / "set")

    return make, tmp_path / "set"


MASS = "scene: cube_toss\neffects: [{name: object_mass, parameters: {mass_scale: {uniform: [0.7, 1.5]}}}]\n"


def test_a_randomisation_may_name_the_scene_and_is_told_by_the_lineage(randomised, capsys):
    from candata.datasets import open_dataset

    make, out = randomised
    assert make(MASS) == 0
    first, second = open_dataset(out)
    assert first.meta.effects != second.meta.effects
    exit_code("registry", "log", out)
    assert "randomisation object_mass(mass_scale {'uniform': [0.7, 1.5]})" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "words", "said"),
    [
        ("", (), "random.yaml is not valid: (whole file): keys with values are expected\n"),
        ("effects: []\n", (), "random.yaml is not valid: (whole file): Value error, expected effects or disturbances"),
        (MASS.replace("uniform", "unifrom"), (), "unknown key `unifrom`, did you mean `uniform`"),
        (MASS.replace("[0.7, 1.5]", "[1.5, 0.7]"), (), "the smallest value of uniform comes first"),
        (MASS.replace("uniform: [0.7, 1.5]", "normal: [1, 0]"), (), "the standard deviation of normal"),
        (MASS.replace("[0.7, 1.5]", "[0.7, 1.5], choice: [1.0]"), (), "expected one of uniform, normal and choice"),
        (MASS.replace("name: object", "share: 1.2, name: object"), (), "effects.0.share: "),
        (MASS, ("--withhold", "any"), "a randomisation and a withheld effect at once"),
        (MASS, ("--effects", "effects.yaml"), "effects and a randomisation at once"),
        (MASS, ("--withhold-from", "random.yaml"), "a randomisation and a withheld effect at once"),
    ],
)
def test_a_wrong_randomisation_is_one_error(randomised, tmp_path, monkeypatch, capsys, text, words, said):
    make, out = randomised
    monkeypatch.chdir(tmp_path)
    (tmp_path / "effects.yaml").write_text("effects: [{name: object_mass, parameters: {mass_scale: 1.5}}]\n")
    assert make(text, *words) == 2
    assert said in capsys.readouterr().err
    assert not out.exists()


def test_effects_withheld_from_a_file_are_not_printed(tmp_path, capsys):
    path, out = tmp_path / "hidden.yaml", tmp_path / "set"
    path.write_text(MASS.replace("[{", "[{name: gravity_tilt, parameters: {tilt_x_rad: {normal: [0, 0.05]}}}, {"))
    words = ("generate-sim", "--withhold-from", path, "--episodes", 2, "--duration-s", 0.2, "--jobs", 1, "--out", out)
    assert exit_code(*words, "--withhold", "any") == 2
    assert capsys.readouterr().err.startswith("--withhold and --withhold-from at once\n")
    assert exit_code(*words) == 0
    printed = capsys.readouterr()
    assert printed.err.endswith(f"withheld effects sealed in {out}.seal.json\n")
    seal = json.loads(out.with_name("set.seal.json").read_text())
    assert [e["name"] for e in json.loads(seal["label"])["effects"]] == ["gravity_tilt", "object_mass"]
    assert not any(word in printed.out + printed.err for word in ("mass", "tilt", seal["salt"]))
    assert exit_code(*words) == 0
    assert capsys.readouterr().out == printed.out, "nothing twice"


def test_an_episode_is_made_again(randomised, tmp_path, capsys):
    make, out = randomised
    make(MASS)
    capsys.readouterr()
    again = ("generate-sim", "--again", out, "--episode", "cube_toss-s1-000001")
    assert exit_code(*again) == 0
    assert capsys.readouterr().out == "cube_toss-s1-000001: bit-equal, 30 rows of 2 channels\n"
    assert exit_code(*again, "--out", tmp_path / "again") == 0
    assert f"{tmp_path / 'again'}: version 1, digest " in capsys.readouterr().out
    assert exit_code("generate-sim", "--again", tmp_path / "again", "--episode", "cube_toss-s1-000001") == 0
    assert exit_code(*again, "--scene", "gripper_tabletop", "--out", tmp_path / "none") == 2
    assert capsys.readouterr().err.startswith("the scene is not the one that the episode was made in\n")
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--again", "set"), "option --episode is missing\n"),
        (("--episode", "x"), "option --again is missing\n"),
        (("--again", "set", "--episode", "x", "--seed", 1), "--again and --seed at once\n"),
        (("--again", "set", "--episode", "x", "--no-noise"), "--again and --noise at once\n"),
        (("--again", "nowhere", "--episode", "x"), "not a dataset\n"),
        (("--scene", "cube_toss", "--episodes", 1), "option --out is missing\n"),
        (("--scene", "cube_toss", "--out", "x"), "option --episodes is missing\n"),
    ],
)
def test_again_takes_an_episode_and_nothing_that_would_change_it(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert exit_code("generate-sim", *words) == 2
    assert capsys.readouterr().err.startswith(said)
    assert list(tmp_path.iterdir()) == []


ARM = """<mujoco><worldbody><body name="arm"><joint name="arm" axis="0 0 1"/><geom size=".1"/></body></worldbody>
  <actuator><position name="arm" joint="arm" kp="9" ctrllimited="true" ctrlrange="-1 1"/></actuator></mujoco>"""


@pytest.fixture
def arm(tmp_path):
    """Words that generate two episodes of a one-joint arm, and a function that writes its policy file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "scene.yaml").write_text("model: arm.xml\nrate_hz: 50\njoints: [arm]\nactuators: [arm]\n")

    def save(name="motion.parquet", **columns):
        pq.write_table(pa.table(columns), tmp_path / name)
        return tmp_path / name

    words = (
        "generate-sim",
        "--scene",
        tmp_path / "scene.yaml",
        "--episodes",
        2,
        "--jobs",
        1,
        "--out",
        tmp_path / "set",
    )
    return words, save


def test_a_policy_file_is_played_as_it_is(arm, tmp_path, capsys):
    from candata.datasets import open_dataset

    words, save = arm
    wave = [0.0, 0.2, 0.4, 0.2]
    path = save("wave.parquet", time_s=[0.0, 0.02, 0.04, 0.06], arm=wave)
    assert exit_code(*words, "--policy-file", path) == 0
    episodes = list(open_dataset(tmp_path / "set"))
    assert [e.meta.task for e in episodes] == ["wave", "wave"]
    assert all(e["action"][:, 0].tolist() == pytest.approx(wave) for e in episodes)
    first = capsys.readouterr().out
    assert exit_code(*words, "--policy-file", path) == 0
    assert capsys.readouterr().out == first, "nothing twice"
    save("wave.parquet", time_s=[0.0, 0.02, 0.04, 0.06], arm=[0.0, 0.2, 0.5, 0.2])
    assert exit_code(*words, "--policy-file", path) == 2
    assert capsys.readouterr().err.startswith(
        "the dataset holds episodes of these ids, made from another configuration"
    )


def test_a_bad_policy_file_is_a_usage_error(arm, tmp_path, capsys):
    words, save = arm
    path = save(time_s=[0.0, 0.02], arm=[0.0, 1.5])
    assert exit_code(*words, "--policy-file", path) == 2
    assert capsys.readouterr().err.startswith("motion 'motion' goes beyond a limit\n  expected: -1 to 1 rad\n")
    assert exit_code(*words, "--policy-file", path, "--policies", "free_sweep") == 2
    assert capsys.readouterr().err.startswith("policies and a policy file at once\n")
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ((), "no scene\n  expected: --scene NAME or scene.yaml\n"),
        (("--scene", "cube_tos"), "unknown scene 'cube_tos'\n"),
        (("--scene", "cube_toss", "--policies", "tos"), "unknown policy 'tos'\n"),
        (
            ("--scene", "cube_toss", "--withhold", "armature"),
            "effect armature cannot act in scene cube_toss\n",
        ),
        (
            ("--scene", "cube_toss", "--effects", "none.yaml"),
            "the effects file cannot be read\n  expected: a YAML file\n",
        ),
        (("--scene", "cube_toss", "--jobs", 0), "--jobs is too small\n"),
    ],
)
def test_a_wrong_word_is_a_usage_error(tmp_path, capsys, words, text):
    assert exit_code("generate-sim", "--episodes", 2, *words, "--out", tmp_path / "set") == 2
    assert capsys.readouterr().err.startswith(text)
    assert not (tmp_path / "set").exists()
    assert not (tmp_path / "set.seal.json").exists()


def test_an_effects_file_that_is_wrong_names_the_field(tmp_path, capsys):
    path = tmp_path / "effects.yaml"
    path.write_text("effects: [{nam: object_mass}]\n")
    assert exit_code("generate-sim", "--episodes", 1, "--effects", path, "--out", tmp_path / "set") == 2
    said = (
        "effects.yaml is not valid: effects.0: unknown key `nam`, did you mean `name`, which is required and missing\n"
    )
    assert capsys.readouterr().err.startswith(said)


def test_scene_list(capsys):
    assert exit_code("scene", "list") == 0
    assert capsys.readouterr().out.splitlines()[1].split()[:6] == ["cube_toss", "0", "0", "0", "148", "Hz"]
    assert exit_code("scene", "list", "--json") == 0
    known = ["cube_toss", "gripper_tabletop", "xarm7_xhand", "xhand_tabletop"]
    assert [e["name"] for e in json.loads(capsys.readouterr().out)] == known


def test_scene_show(tmp_path, capsys):
    picture = tmp_path / "pictures" / "scene.png"
    assert exit_code("scene", "show", "xhand_tabletop", "--out", picture) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "control   80 Hz, 5 physics steps of 2.5 ms; implicitfast, elliptic cone, newton solver" in lines
    assert "object    object, 0.25 kg; support table" in lines
    index2 = next(line for line in lines if line.startswith("index2 "))
    cells = [
        "index2",
        "hinge",
        "rad",
        "0 .. 1.92",
        "index2",
        "position servo",
        "3 N m/rad",
        "0.08 N m s/rad",
        "0.4 N m",
    ]
    assert re.split(r"  +", index2) == [*cells, "index"]
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_scene_show_json_is_one_object(capsys):
    assert exit_code("scene", "show", "cube_toss", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["object"], found["rate_hz"], found["policies"]) == ("object", 148.0, ["toss"])


def test_scene_show_of_an_unknown_scene(capsys):
    assert exit_code("scene", "show", "cube") == 2
    assert capsys.readouterr().err.startswith("unknown scene 'cube'\n")


@pytest.fixture
def diagnosis(monkeypatch):
    """Put a report that names one effect in the place of the diagnosis."""

    def plant(name: str, parameters: dict[str, float]) -> list:
        calls = []

        def diagnose(dataset, scene, *, jobs, progress, ends):
            calls.append((dataset.name, scene.name, jobs, len(dataset)))
            named = NamedEffect(
                name=name,
                share=0.9,
                support=0.95,
                parameters={k: Estimate(value=v, low=v - 0.1, high=v + 0.1) for k, v in parameters.items()},
            )
            data = DiagnosisData(
                dataset="real@0", episodes=EpisodeCount(total=2, folds=2, held_out=2), floor="declared"
            )
            return SimpleNamespace(report=Report(verdict="explained", effects=(named,), data=data), named=())

        monkeypatch.setattr("candata.gap.diagnose", diagnose)
        monkeypatch.setattr(
            "candata.reports.write_diagnosis", lambda _found, _scene, out, _context: out / "report.html"
        )
        return calls

    return plant


def test_demo_shows_the_verdict_beside_the_truth(tmp_path, capsys, diagnosis):
    calls = diagnosis("object_mass", {"mass_scale": 2.0})
    assert exit_code("demo", "--seed", 2, "--episodes", 2, "--out", tmp_path, "--jobs", 1) == 0
    printed = capsys.readouterr().out
    folder = tmp_path / "seed-2"
    assert calls == [("real", "xhand_tabletop", 1, 2)]
    assert "hidden fault: object_mass, found\n" in printed
    assert re.search(r"mass_scale +[12]\.\d+ +2 +1\.9 \.\. 2\.1", printed)
    assert f"candata generate-sim --effects {folder / 'report' / 'effects.yaml'} " in printed
    assert printed.endswith(f"report: {folder / 'report' / 'report.html'}\n")


def test_a_quick_demo_takes_the_gripper_and_the_fewest_episodes(tmp_path, diagnosis):
    calls = diagnosis("joint_dry_friction", {"frictionloss_Nm": 0.1})
    assert exit_code("demo", "--quick", "--out", tmp_path, "--jobs", 1, "--json") == 0
    assert calls == [("real", "gripper_tabletop", 1, 8)]


@pytest.mark.parametrize(("element", "outcome"), [("mid1", "found"), ("mid2", "missed"), (None, "missed")])
def test_the_demo_asks_for_the_joint_too(element, outcome):
    truth = EffectSetting(name="joint_dry_friction", element="mid1", parameters={"frictionloss_Nm": 0.1})
    named = NamedEffect(name=truth.name, element=element, share=1.0, support=1.0, parameters={})
    data = DiagnosisData(dataset="real@0", episodes=EpisodeCount(total=8, folds=4, held_out=8))
    assert demo_command.judge(Report(verdict="explained", effects=(named,), data=data), truth) == outcome
    tied = Report(verdict="ambiguous", ambiguous_class=("joint_dry_friction mid1", "x"), data=data)
    assert demo_command.judge(tied, truth) == "found in a class"


@pytest.mark.parametrize("scene", [demo_command.SCENE, demo_command.QUICK_SCENE])
def test_what_the_demo_hides_is_a_fault_of_hardware(scene):
    """None is a word of the solver, and each can be simulated in the scene."""
    world = load_scene(scene)
    for seed in range(1, 8):
        (fault,) = demo_command.hidden_fault(scene, seed).effects
        assert not effect(fault.name).traits & {"solver", "simulator"}
        check_randomisation([fault], world)


def test_demo_says_so_when_it_misses(tmp_path, capsys, diagnosis):
    diagnosis("armature", {"armature_kgm2": 0.1})
    words = ("demo", "--seed", 2, "--episodes", 2, "--out", tmp_path, "--jobs", 1, "--json")
    assert exit_code(*words) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["outcome"], found["truth"]["name"]) == ("missed", "object_mass")
    assert (tmp_path / "seed-2" / "nominal" / "versions" / "000001.json").is_file()
