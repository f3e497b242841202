"""`candata diagnose`: the files it writes, what it prints, how it ends, and what it refuses."""

from __future__ import annotations

import html
import json
import re
import shlex
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from candata.datasets import create_dataset, open_dataset
from candata.reports import ReportContext, summary
from candata.schema.effect import EffectsFile
from candata.schema.report import Report
from tests.cli.command import run

SCHEMAS = Path(__file__).resolve().parents[2] / "schemas"
FILES = ["effects.yaml", "report.html", "report.json"]
#: Short throws that still strike and settle; eight are the fewest that are diagnosed.
TOSSES = ("generate-sim", "--scene", "cube_toss", "--duration-s", 0.7, "--jobs", 1)


def toss(folder: Path, episodes: int, *more: object) -> Path:
    assert run(*TOSSES, "--episodes", episodes, *more, "--out", folder).code == 0
    return folder


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory) -> SimpleNamespace:
    """One diagnosis of tosses in a world with an elliptic cone."""
    folder = tmp_path_factory.mktemp("diagnose")
    effects = folder / "hidden.yaml"
    effects.write_text("effects: [{name: friction_cone, parameters: {cone: elliptic}}]\n")
    dataset = toss(folder / "real", 10, "--seed", 5, "--effects", effects)
    out = folder / "deep" / "report"
    done = run("diagnose", dataset, "--scene", "cube_toss", "--out", out, "--jobs", 1, "--json")
    return SimpleNamespace(dataset=dataset, out=out, code=done.code, printed=done.out, err=done.err)


@pytest.fixture(scope="module")
def three(tmp_path_factory) -> Path:
    """Too few tosses to say anything."""
    return toss(tmp_path_factory.mktemp("three") / "real", 3)


def agrees(schema: dict, value: object, root: dict) -> bool:
    """Tell whether a value keeps a JSON Schema, as far as those that candata writes go."""
    if "$ref" in schema:
        return agrees(root["$defs"][schema["$ref"].rsplit("/", 1)[1]], value, root)
    if "anyOf" in schema:
        return any(agrees(s, value, root) for s in schema["anyOf"])
    if "enum" in schema and value not in schema["enum"]:
        return False
    kinds = {"object": dict, "array": list, "string": str, "boolean": bool, "integer": int, "null": type(None)}
    kinds["number"] = (int, float)
    if "type" in schema and not isinstance(value, kinds[schema["type"]]):
        return False
    if isinstance(value, dict):
        known, extra = schema.get("properties", {}), schema.get("additionalProperties", True)
        return set(schema.get("required", ())) <= set(value) and all(
            agrees(known[k], v, root) if k in known else extra is True or (extra and agrees(extra, v, root))
            for k, v in value.items()
        )
    return not isinstance(value, list) or all(agrees(schema.get("items", {}), v, root) for v in value)


def test_it_exits_0_and_writes_three_files(diagnosed):
    assert diagnosed.code == 0
    assert sorted(p.name for p in diagnosed.out.iterdir()) == FILES


def test_the_report_keeps_record_and_schema(diagnosed):
    text = (diagnosed.out / "report.json").read_text()
    schema = json.loads((SCHEMAS / "report.schema.json").read_text())
    plain = json.loads(text)
    assert Report.model_validate_json(text).verdict == "explained"
    assert agrees(schema, plain, schema)
    # The control: the check refuses what the record has not.
    assert not agrees(schema, plain | {"verdict": "solved"}, schema)
    assert not agrees(schema, {k: v for k, v in plain.items() if k != "next_motion"}, schema)
    assert not agrees(schema, plain | {"gap": {**plain["gap"], "closed": "most"}}, schema)


def test_every_promised_key_is_there(diagnosed):
    keys = {"verdict", "effects", "class", "unknown", "ranking", "gap", "where", "next_motion", "data"}
    assert keys <= set(json.loads(diagnosed.out.joinpath("report.json").read_text()))


def test_json_prints_the_same_record_and_nothing_else(diagnosed):
    assert json.loads(diagnosed.printed) == json.loads(diagnosed.out.joinpath("report.json").read_text())


def test_notes_go_to_stderr(diagnosed):
    assert diagnosed.err.splitlines()[0] == "reading"
    assert diagnosed.err.endswith(f"report: {diagnosed.out / 'report.html'}\n")


@pytest.mark.parametrize("says", ["page", "summary"])
def test_commands_run_as_they_are_printed(diagnosed, tmp_path, monkeypatch, says):
    """Those of the page in its folder, wherever that lies; those of the summary where the diagnosis ran."""
    copy = tmp_path / "sent by mail" / "report"
    shutil.copytree(diagnosed.out, copy)
    page = html.unescape((copy / "report.html").read_text("utf-8"))
    assert '<option cone="elliptic"/>' in page
    if says == "page":
        stands, commands = copy, re.findall(r"<code>candata (.*?)</code>", re.sub(r"</?span[^>]*>", "", page))
    else:
        context = ReportContext(copy.relative_to(tmp_path), mjcf_lines=('<option cone="elliptic"/>',))
        text = summary(Report.model_validate_json((copy / "report.json").read_text()), context)
        stands, commands = tmp_path, re.findall(r"^  candata (.*)$", text, re.M)
    monkeypatch.chdir(stands)
    assert [command.split(" --")[0] for command in commands] == ["generate-sim", "scene export"]
    assert [run(*shlex.split(command)).code for command in commands] == [0, 0]
    assert len(open_dataset(stands / "repaired")) == 8
    assert 'cone="elliptic"' in (stands / "repaired_model" / "scene.xml").read_text()


def test_the_dataset_is_named_with_its_digest(diagnosed):
    found = Report.model_validate_json((diagnosed.out / "report.json").read_text()).data
    assert found.dataset == f"real@{open_dataset(diagnosed.dataset).digest[:12]}"
    assert (found.episodes.total, found.episodes.folds, found.floor) == (10, 4, "declared")


def test_the_effects_are_a_simulator_that_runs(diagnosed, tmp_path):
    path = diagnosed.out / "effects.yaml"
    effects = EffectsFile.parse(yaml.safe_load(path.read_text()), path)
    assert effects.scene == "cube_toss"
    assert [(e.name, e.parameters) for e in effects.effects] == [("friction_cone", {"cone": "elliptic"})]
    # The file names the scene, so no --scene is needed.
    made = run(
        "generate-sim",
        "--effects",
        path,
        "--episodes",
        1,
        "--duration-s",
        0.2,
        "--jobs",
        1,
        "--out",
        tmp_path / "repaired",
    )
    assert made.code == 0
    assert next(iter(open_dataset(tmp_path / "repaired"))).meta.effects == effects.effects


def test_the_page_stands_alone(diagnosed):
    page = (diagnosed.out / "report.html").read_text()
    assert page.lower().startswith("<!doctype html>")
    assert "friction_cone" in page
    assert 'src="http' not in page
    assert 'class="panel"' in page, "the episodes of the heat map's elements"
    assert "Which candidates look alike" in page


def test_without_json_a_summary_is_printed(three, tmp_path):
    done = run("diagnose", three, "--scene", "cube_toss", "--out", tmp_path / "out")
    assert done.code == 0
    assert "too_little_data" in done.out
    assert not done.out.startswith("{")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == FILES
    assert yaml.safe_load((tmp_path / "out" / "effects.yaml").read_text())["effects"] == []


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("too_little_data", 1),
        ("unknown_effect, too_little_data", 1),
        ("unknown_effect,ambiguous", 0),
        ("", 0),
    ],
)
def test_fail_on_turns_a_verdict_into_exit_1(three, tmp_path, words, code):
    done = run("diagnose", three, "--scene", "cube_toss", "--out", tmp_path / "out", "--fail-on", words, "--json")
    assert done.code == code
    assert json.loads(done.out)["verdict"] == "too_little_data"
    assert (tmp_path / "out" / "report.json").is_file(), "the report is written all the same"


@pytest.mark.parametrize(
    "by",
    [
        "digest",
        "number",
    ],
)
def test_an_older_version_can_be_diagnosed(tmp_path, by):
    dataset = toss(tmp_path / "real", 2)
    older = {"digest": open_dataset(dataset).digest[:12], "number": "1"}[by]
    toss(dataset, 3)
    for more, count in (((), 3), (("--version", older), 2)):
        done = run("diagnose", dataset, *more, "--scene", "cube_toss", "--out", tmp_path / "out", "--json")
        assert (done.code, done.err[:10]) == (0, "reading\nwr")
        assert json.loads(done.out)["data"]["episodes"]["total"] == count


@pytest.mark.parametrize("words", [("--seed", -1), ("--out", "file")])
def test_an_option_that_cannot_be_is_a_usage_error(three, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("mine")
    done = run("diagnose", three, "--scene", "cube_toss", "--out", "out", *words)
    assert (done.code, done.out) == (2, "")
    assert Path("file").read_text() == "mine"


def test_an_unknown_verdict_is_a_usage_error(three, tmp_path):
    done = run("diagnose", three, "--scene", "cube_toss", "--out", tmp_path / "out", "--fail-on", "explained,unknown")
    assert done.code == 2
    assert done.err.startswith("unknown verdict 'unknown'\n  expected: one of ambiguous, explained, ")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("scene", "text"),
    [
        ("nowhere/scene.yaml", "scene file nowhere/scene.yaml does not exist\n"),
        ("cube", "unknown scene 'cube'\n"),
    ],
)
def test_a_scene_that_does_not_exist_is_refused(three, tmp_path, scene, text):
    done = run("diagnose", three, "--scene", scene, "--out", tmp_path / "out")
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith(text)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("effects: [{name: pose_bais}]", "unknown effect 'pose_bais'"),
        (
            "effects: [{name: object_mass, parameters: {mass_scale: -2}}]",
            "mass_scale is not possible in scene",
        ),
        ("effects: [{name: servo_gain, parameters: {kp_scale: 2}}]", "servo_gain cannot act in scene cube_toss"),
        ("effects: 3", "effects"),
    ],
)
def test_effects_that_cannot_be_given_are_refused(three, tmp_path, text, words):
    path = tmp_path / "given.yaml"
    path.write_text(text)
    done = run("diagnose", three, "--scene", "cube_toss", "--effects", path, "--out", tmp_path / "out")
    assert (done.code, done.out) == (2, "")
    assert words in done.err
    assert "Traceback" not in done.err
    assert not (tmp_path / "out").exists()


def test_given_effects_stand_in_the_report_and_in_the_repaired_simulator(three, tmp_path):
    path = tmp_path / "given.yaml"
    path.write_text("scene: xhand_tabletop\neffects: [{name: object_mass, parameters: {mass_scale: 1.2}}]")
    done = run("diagnose", three, "--scene", "cube_toss", "--effects", path, "--out", tmp_path / "out")
    assert done.code == 0
    assert "given.yaml was made for another scene: xhand_tabletop" in done.err
    assert "effects that the nominal simulator holds already: object_mass" in " ".join(done.out.split())
    report = Report.model_validate_json((tmp_path / "out" / "report.json").read_text())
    assert [effect.name for effect in report.given_effects] == ["object_mass"]
    written = EffectsFile.model_validate(yaml.safe_load((tmp_path / "out" / "effects.yaml").read_text()))
    assert written.effects == report.given_effects


def test_a_dataset_that_does_not_exist_is_refused(tmp_path):
    done = run("diagnose", tmp_path / "nowhere", "--scene", "cube_toss", "--out", tmp_path / "out")
    assert (done.code, done.out) == (2, "")
    assert str(tmp_path / "nowhere") in done.err
    assert "Traceback" not in done.err
    assert not (tmp_path / "out").exists()


def test_an_empty_dataset_is_refused(tmp_path):
    create_dataset(tmp_path / "real")
    done = run("diagnose", tmp_path / "real", "--scene", "cube_toss", "--out", tmp_path / "out")
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith("empty dataset\n")
    assert not (tmp_path / "out").exists()


def test_a_dataset_of_another_robot_is_refused(three, tmp_path):
    done = run("diagnose", three, "--scene", "xhand_tabletop", "--out", tmp_path / "out")
    assert (done.code, done.out) == (2, "")
    assert "the episode's rate is not the scene's\n  expected: 80 Hz\n  found: 148 Hz, 1.85 times that\n" in done.err
    assert not (tmp_path / "out").exists()


def test_a_missing_option_is_a_usage_error(three, tmp_path):
    done = run("diagnose", three, "--out", tmp_path / "out")
    assert done.code == 2
    assert "--scene" in done.err


def test_what_changed_cannot_be_asked_of_tosses(diagnosed, tmp_path):
    done = run("diagnose", diagnosed.dataset, "--against", diagnosed.dataset, "--scene", "cube_toss", "--out", tmp_path)
    assert (done.code, done.out) == (2, "")
    assert "tosses cannot be compared with a reference" in done.err
    assert "diagnose each data set by itself" in done.err


def test_a_reference_must_be_there(diagnosed, tmp_path):
    done = run("diagnose", diagnosed.dataset, "--against", tmp_path / "gone", "--scene", "cube_toss", "--out", tmp_path)
    assert (done.code, done.out) == (2, "")
    assert "gone" in done.err


def test_a_model_stands_beside_the_repair_in_one_unit(diagnosed, tmp_path):
    sim, model = toss(tmp_path / "sim", 10, "--seed", 9), tmp_path / "mlp"
    shape = ("--history", 3, "--horizon", 4, "--rate-hz", 37)
    assert run("train", "--data", sim, "--model", "mlp", "--steps", 4, *shape, "--out", model).code == 0
    words = ("--scene", "cube_toss", "--only", "friction_cone", "--out", tmp_path / "report", "--jobs", 1)
    done = run("diagnose", diagnosed.dataset, *words, "--run", model)
    assert done.code == 0, done.err
    assert "model      The model mlp closes" in done.out
    learned = Report.model_validate_json((tmp_path / "report" / "report.json").read_text()).learned
    assert (learned.run, learned.model, learned.episodes) == (str(model), "mlp", 10)
    # The true effect against a net of four steps: the repair nears the recordings, the net does not.
    assert learned.repair.adds_auc > learned.nominal_auc > learned.closed.adds_auc
    assert learned.repair.share > 0 > learned.closed.share


@pytest.mark.parametrize(
    ("words", "said"),
    [(("--run", "nowhere"), "no such checkpoint"), (("--run", "r", "--effects", "e.yaml"), "--run with --against")],
)
def test_a_run_that_cannot_be_compared_is_refused_at_once(three, tmp_path, words, said):
    done = run("diagnose", three, "--scene", "cube_toss", "--out", tmp_path / "report", *words)
    assert (done.code, said in done.err) == (2, True), done.err
    assert not (tmp_path / "report").exists()


def test_a_run_that_was_trained_on_the_recordings_is_refused(diagnosed, tmp_path):
    words = ("--model", "mlp", "--steps", 2, "--history", 3, "--horizon", 4, "--rate-hz", 37)
    other, model = tmp_path / "copy", tmp_path / "mlp"
    assert run("registry", "filter", diagnosed.dataset, "id <> 'cube_toss-s5-000002'", "--out", other).code == 0
    assert run("train", "--data", other, *words, "--out", model).code == 0
    done = run(
        "diagnose", diagnosed.dataset, "--scene", "cube_toss", "--out", tmp_path / "report", "--run", tmp_path / "mlp"
    )
    assert (done.code, "the run was trained on recordings that are diagnosed" in done.err) == (2, True), done.err
    assert not (tmp_path / "report").exists()
