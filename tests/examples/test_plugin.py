"""The example package of plug-ins: installed, it passes its own conformance tests and runs from the command line."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from candata.plugins import REGISTRIES

ROOT = Path(__file__).resolve().parents[2]
PLUGIN = ROOT / "examples" / "plugin"

pytest.importorskip("setuptools")
pytest.importorskip("torch")


#: An emulated hand waits for its reader for ever: what a failed command leaves running is ended.
ENDS = "trap 'kill $(jobs -p) 2>/dev/null || true' EXIT"


def environment(site: Path) -> dict[str, str]:
    """An environment in which the packages of `site` and this checkout are installed."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), str(ROOT)])}


def run(words: list[str], cwd: Path, site: Path) -> subprocess.CompletedProcess:
    """Run a command; `candata` is this checkout's."""
    words = [sys.executable, "-m", "candata_cli.main", *words[1:]] if words[0] == "candata" else words
    return subprocess.run(words, cwd=cwd, env=environment(site), capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> tuple[Path, Path]:
    """A copy of the package, and the folder in which pip has installed it without a network."""
    work = tmp_path_factory.mktemp("plugin")
    source = shutil.copytree(PLUGIN, work / "source")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    done = run([*pip, "--target", str(work / "site"), str(source)], work, work / "site")
    assert done.returncode == 0, done.stderr
    return source, work / "site"


def test_it_brings_one_of_every_kind():
    groups = re.findall(r'entry-points\."candata\.(\w+)"', (PLUGIN / "pyproject.toml").read_text(encoding="utf-8"))
    assert sorted(groups) == sorted(REGISTRIES)


def test_its_own_conformance_tests_pass(installed):
    source, site = installed
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", str(source), "tests"]
    done = run(words, source, site)
    assert done.returncode == 0, done.stdout[-4000:]
    assert "skipped" not in done.stdout


def test_the_commands_of_its_readme_run(installed, tmp_path):
    _, site = installed
    text = (PLUGIN / "README.md").read_text(encoding="utf-8")
    block = text.split("```bash\n")[1].split("```")[0]
    commands = [line for line in block.splitlines() if not line.startswith(("pip ", "python "))]
    script = tmp_path / "candata"
    script.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m candata_cli.main "$@"\n')
    script.chmod(0o755)
    env = environment(site) | {"PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}
    shell = ["bash", "-euo", "pipefail", "-c", "\n".join([ENDS, *commands, "wait"])]
    done = subprocess.run(shell, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    listed = [line.split()[1] for line in done.stdout.splitlines() if "candata-example 0.1.0" in line]
    assert sorted(listed) == sorted(path.stem for path in (PLUGIN / "candata_example").glob("[a-z]*.py"))
    assert "12 episodes added" in done.stdout


def test_its_effect_is_planted_by_name(installed, tmp_path):
    _, site = installed
    effects = tmp_path / "effects.yaml"
    effects.write_text("effects: [{name: return_spring, parameters: {stiffness_Nm_rad: 0.2}}]\n")
    words = ["candata", "generate-sim", "--scene", "two_finger_tabletop", "--episodes", "2", "--seed", "1"]
    done = run([*words, "--effects", str(effects), "--out", "springs"], tmp_path, site)
    assert done.returncode == 0, done.stderr
    far = effects.with_name("far.yaml")
    far.write_text("effects: [{name: return_spring, parameters: {stiffness_Nm_rad: 200}}]\n")
    done = run([*words, "--effects", str(far), "--out", "more"], tmp_path, site)
    assert done.returncode == 2
    assert "return_spring: stiffness_Nm_rad is not possible in scene two_finger_tabletop" in done.stderr
