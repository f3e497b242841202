"""`candata train` and `candata evaluate`: what they write and print, how they go on, and what they refuse."""

from __future__ import annotations

import json
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import time
from importlib import util
from pathlib import Path
from types import SimpleNamespace

import pytest

from candata.datasets import open_dataset
from candata.errors import UsageError
from candata.reports import filmstrip
from candata.training import TrainingSettings, TrainRequest, prepare
from candata.training.processes import Processes
from candata.training.results import Evaluation
from candata.training.steplog import read_log
from tests.cli.command import run

ROOT = Path(__file__).resolve().parents[2]
#: A net of a few thousand weights: what is tested is the way, not the forecast.
CONFIG = "{width: 16, layers: 1}"


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    """Ten simulated episodes of the hand."""
    folder = tmp_path_factory.mktemp("data") / "sim"
    words = ("--scene", "xhand_tabletop", "--episodes", 10, "--duration-s", 2.4, "--jobs", 1, "--out", folder)
    assert run("generate-sim", *words).code == 0
    return folder


@pytest.fixture(scope="module")
def tosses(tmp_path_factory) -> Path:
    """Tosses: an object, and no hand."""
    folder = tmp_path_factory.mktemp("data") / "tosses"
    words = ("--scene", "cube_toss", "--episodes", 4, "--duration-s", 0.5, "--jobs", 1, "--out", folder)
    assert run("generate-sim", *words).code == 0
    return folder


def words(data: Path, out: Path, *more: object, steps: int = 6) -> tuple[object, ...]:
    config = out.parent / "config.yaml"
    config.write_text(CONFIG)
    fixed = ("--model", "mlp", "--config", config, "--batch", 8, "--threads", 1)
    return ("train", "--data", data, "--out", out, *fixed, "--steps", steps, *more)


@pytest.fixture(scope="module")
def trained(data, tmp_path_factory) -> SimpleNamespace:
    """A short run, and what its command printed."""
    out = tmp_path_factory.mktemp("train") / "run"
    done = run(*words(data, out))
    assert done.code == 0
    return SimpleNamespace(out=out, data=data, printed=done)


def test_train_says_what_stands_and_what_comes_next(trained):
    assert trained.printed.out.startswith(f"{trained.out}: mlp, 6 steps in ")
    assert "least held-out loss" in trained.printed.out
    assert trained.printed.err.endswith(f"next: candata evaluate {trained.out} {trained.data}\n")


def test_the_same_command_again_trains_no_more(trained):
    before = (trained.out / "last.safetensors").read_bytes()
    again = run(*words(trained.data, trained.out))
    assert again.code == 0
    assert again.out == trained.printed.out
    assert (trained.out / "last.safetensors").read_bytes() == before


def test_other_settings_are_refused(trained):
    done = run(*words(trained.data, trained.out, "--seed", 3))
    assert done.code == 2
    assert "the folder holds a run with other settings" in done.err
    assert "settings.seed 0" in done.err
    assert "settings.seed 3" in done.err


def test_train_prints_json(trained):
    done = run(*words(trained.data, trained.out, "--json"))
    assert json.loads(done.out)["step"] == 6


@pytest.fixture
def small_pictures(monkeypatch):
    """Pictures of few pixels, drawn without a GL library."""
    monkeypatch.setenv("CANDATA_GL", "off")
    monkeypatch.setattr(filmstrip, "WIDTH", 48)
    monkeypatch.setattr(filmstrip, "HEIGHT", 40)


def test_evaluate_prints_a_row_each_and_writes_both_files(trained, tmp_path, small_pictures):
    done = run("evaluate", trained.out, trained.data, "--out", tmp_path / "page")
    assert done.code == 0, done.err
    rows = [line.split()[0] for line in done.out.splitlines() if line and line[0] != " "]
    assert {"run", "simulator", "stays", "keeps_velocity"} <= set(rows)
    assert "1 test trajectories are fewer than 30: the tables have no intervals" in done.out
    assert sorted(p.name for p in (tmp_path / "page").iterdir()) == ["evaluation.html", "evaluation.json"]
    assert done.err.endswith(f"page: {tmp_path / 'page' / 'evaluation.html'}\n")
    found = Evaluation.model_validate_json((tmp_path / "page" / "evaluation.json").read_text())
    assert (found.group, found.episodes, found.samples, found.joints_from) == ("test", 1, 16, "recorded")
    assert (found.models["run"].model, found.models["run"].execute) == ("mlp", 8)
    # The episodes were simulated in this very scene: what the simulator errs by is what its start is not known by.
    simulated, still = (found.forecasters[name].closed_loop.adds_auc for name in ("simulator", "stays"))
    assert simulated > max(0.97, still)
    assert (tmp_path / "page" / "evaluation.html").read_text().count("<img ") == 15


def test_evaluate_compares_runs_and_a_repair_and_prints_json(trained, tmp_path, small_pictures):
    second, effects = tmp_path / "second", tmp_path / "effects.yaml"
    shutil.copytree(trained.out, second)
    effects.write_text("scene: xhand_tabletop\neffects: [{name: object_mass, parameters: {mass_scale: 2.0}}]\n")
    fixed = ("--split", "val", "--samples", 1, "--no-baselines", "--joints", "simulator", "--effects", effects)
    done = run("evaluate", trained.out, second, trained.data, *fixed, "--out", tmp_path / "page", "--json")
    assert done.code == 0, done.err
    found = Evaluation.model_validate_json(done.out)
    assert (found.group, list(found.forecasters)) == ("val", ["run", "second", "simulator", "repaired simulator"])
    assert found.forecasters["run"].closed_loop == found.forecasters["second"].closed_loop
    assert found.simulators["repaired simulator"].effects[0].name == "object_mass"
    assert found.joints_from == "repaired simulator"
    # Twice the mass is wrong for these episodes.
    assert found.pair("simulator", "repaired simulator").value > 0


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--joints", "servos"), "did you mean 'servo'"),
        (("--scene", "gripper_tabletop"), "does not fit scene gripper_tabletop"),
        (("--scene", "nowhere"), "unknown scene"),
        (("--effects", "nowhere.yaml"), "nowhere.yaml"),
        (("--no-simulator", "--scene", "xhand_tabletop"), "leave --no-simulator out"),
    ],
)
def test_evaluate_names_a_wrong_word(trained, tmp_path, more, said):
    done = run("evaluate", trained.out, trained.data, "--out", tmp_path / "page", *more)
    assert (done.code, said in done.err) == (2, True), done.err


#: The losses of two processes equal those of one within this: sums round apart.
SHARED_TOLERANCE = 1e-5


def test_two_processes_train_as_one_and_one_goes_on(data, tmp_path):
    noise = ("--pose-noise-m", 0.002, "--command-noise", 0.01, "--learning-rate", 0.003)
    shared = [str(word) for word in words(data, tmp_path / "two", *noise, steps=20)]
    launcher = ("-m", "torch.distributed.run", "--nproc-per-node", "2", "--standalone", "-m", "candata_cli.main")
    env = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    two = subprocess.run([sys.executable, *launcher, *shared], env=env, capture_output=True, text=True, check=True)
    assert two.stdout.count("mlp, 20 steps in ") == 1, "each process speaks"
    assert run(*words(data, tmp_path / "one", *noise, steps=20)).code == 0
    one_log, two_log = (read_log(tmp_path / name) for name in ("one", "two"))
    assert [line["step"] for line in one_log] == [line["step"] for line in two_log]
    for one_line, two_line in zip(one_log, two_log, strict=True):
        for name in {"loss", "gradient_norm", "held_out_loss"} & set(one_line):
            assert two_line[name] == pytest.approx(one_line[name], abs=SHARED_TOLERANCE)
    again = run(*shared)
    assert again.code == 0
    assert "mlp, 20 steps in " in again.out


def test_a_batch_that_does_not_divide_is_refused(data, tmp_path):
    settings = TrainingSettings(batch=9)
    with pytest.raises(UsageError, match=r"does not divide among the processes\n\s+expected: --batch: a multiple of 2"):
        prepare(open_dataset(data), TrainRequest("mlp"), settings, processes=Processes(0, 2))


def test_ctrl_c_saves_and_the_same_command_goes_on(data, tmp_path):
    out = tmp_path / "run"
    command = [str(a) for a in words(data, out, steps=100_000)]
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen([sys.executable, "-m", "candata_cli.main", *command], env=env, stderr=subprocess.PIPE) as one:
        deadline, log = time.monotonic() + 60, out / "log.jsonl"
        while not (log.is_file() and log.read_text().count("\n") > 2):
            assert one.poll() is None, one.stderr.read().decode()
            assert time.monotonic() < deadline, "the command does not train"
            time.sleep(0.02)
        one.send_signal(signal.SIGINT)
        said = one.stderr.read().decode()
    assert one.returncode == 130
    assert re.search(rf"^stopped: saved at step \d+ in {out}\n  to go on: candata train --data ", said, re.MULTILINE)
    assert (out / "last.safetensors").is_file()


def test_fine_tuning_says_its_rate(trained, tmp_path):
    done = run("train", "--data", trained.data, "--init", trained.out, "--out", tmp_path / "tuned", "--steps", 2)
    assert done.code == 0
    assert f"fine-tuning {trained.out} at a rate of 1e-05" in done.err
    assert json.loads((tmp_path / "tuned" / "run.json").read_text())["init"]["step"] == 6


def test_data_without_a_hand_is_refused_in_one_message(tosses, tmp_path):
    done = run("train", "--data", tosses, "--model", "contact_diffusion", "--out", tmp_path / "run", "--steps", 2)
    assert done.code == 2
    assert "the dataset lacks the channel contact" in done.err
    assert not (tmp_path / "run").exists()


def test_a_pickle_is_refused(data, tmp_path):
    (tmp_path / "model.pt").write_bytes(pickle.dumps({"weights": [1]}))
    done = run("evaluate", tmp_path / "model.pt", data)
    assert done.code == 2
    assert "the checkpoint is a pickle, which can run any code when opened: refused" in done.err


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--horizon", 60), "no episode is long enough for a window"),
        (("--split", "mine"), "unknown split 'mine'"),
        (("--rate-hz", 30), "no whole multiple"),
        (("--rate-hz", 0), "rate_hz must be positive"),
        (("--seed", 2**64), "Invalid value for '--seed'"),
        (("--device", "tpu"), "one of cpu, cuda"),
        (("--learning-rate", 0), "--learning-rate is out of range"),
        (("--preset", "huge"), "one of base, paper, small"),
        (("--normaliser", "quantil"), "did you mean 'quantile'"),
        (("--command-noise", -1), "greater than or equal to 0"),
        (("--pose-noise-m", "nan"), "position_m"),
        (("--data", "sim:0.7,real:0.2"), "do not add up to 1"),
        (("--data", "nowhere:0.7,else:0.3"), "not a dataset"),
        (("--data", "a/x:0.7,b/x:0.3"), "two datasets of a mixture have one name"),
        (("--data", "a:0.7,b:0.3", "--version", "2"), "--version is of one dataset"),
    ],
)
def test_a_wrong_word_is_named(data, tmp_path, more, said):
    done = run(*words(data, tmp_path / "run", *more))
    assert (done.code, said in done.err) == (2, True), done.err
    assert not (tmp_path / "run").exists()


def test_a_mixture_is_trained_on_and_its_shares_are_told(data, tmp_path):
    second = tmp_path / "real"
    second.symlink_to(data)
    told = f"{data}:0.7,{second}:0.3"
    done = run(*words(data, tmp_path / "run", "--data", told, "--normaliser", "quantile", "--command-noise", 0.01))
    assert done.code == 0, done.err
    assert "values clipped of" in done.err
    assert "\nsim: asked 70.0%, drew 34 windows (70.8%)" in done.out
    assert "\nreal: asked 30.0%, drew 14 windows (29.2%)" in done.out
    again = run(
        *words(data, tmp_path / "run", "--data", told, "--normaliser", "quantile", "--command-noise", 0.01, "--json")
    )
    assert [one["drawn"] for one in json.loads(again.out)["sources"]] == [34, 14]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"\x80\x81", "--config is no YAML\n  expected: text in UTF-8"),
        (b"a: [", "--config is no YAML\n  found: while parsing"),
        (b"seed: 18446744073709551616", "seed: Input should be less than 18446744073709551616"),
    ],
)
def test_a_config_that_cannot_be_read(data, tmp_path, text, said):
    (tmp_path / "bad.yaml").write_bytes(text)
    done = run("train", "--data", data, "--model", "mlp", "--config", tmp_path / "bad.yaml", "--out", tmp_path / "run")
    assert (done.code, said in done.err) == (2, True), done.err


def test_a_config_that_is_none(data, tmp_path):
    (tmp_path / "bad.yaml").write_text("[1, 2]")
    done = run("train", "--data", data, "--model", "mlp", "--config", tmp_path / "bad.yaml", "--out", tmp_path / "run")
    assert (done.code, "--config holds no fields" in done.err) == (2, True)


@pytest.mark.parametrize("package", ["torch", "safetensors"])
def test_a_missing_package_is_an_install_hint(package, data, tmp_path, monkeypatch):
    real = util.find_spec
    monkeypatch.setattr(util, "find_spec", lambda name, *rest: None if name == package else real(name, *rest))
    for command in (words(data, tmp_path / "run"), ("evaluate", tmp_path, data)):
        done = run(*command)
        assert done.code == 3
        assert done.err == f'{package} is not installed\n  do: pip install "candata[train]"\n'


def test_the_room_needs_no_torch_for_its_metrics():
    code = (
        "import sys, types\n"
        "def refuse(name, *_):\n"
        "    if name.split('.')[0] == 'torch': raise ImportError(name)\n"
        "sys.meta_path.insert(0, types.SimpleNamespace(find_spec=refuse))\n"
        "import candata.training, candata.training.metrics, candata.training.poses, candata.training.results\n"
        "import candata.training.scoring, candata.reports.evaluation\n"
    )
    subprocess.run([sys.executable, "-c", code], env=os.environ | {"PYTHONPATH": str(ROOT)}, check=True)
