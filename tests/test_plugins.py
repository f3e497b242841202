"""Plug-ins of other packages: found by their entry points, refused in words, and never in the way of built-in ones."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
EFFECT = """
from candata.effects import EFFECTS, effect
from dataclasses import replace
EFFECT = replace(effect("object_mass"), about="mass again")
"""


class Site:
    """A folder on the path in which packages are installed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def install(self, package: str, points: dict[str, str], code: str = "") -> None:
        """Put in a package of one module with entry points, by group and then as `name = module:CONSTANT`."""
        module = package.replace("-", "_")
        (self.folder / f"{module}.py").write_text(code)
        info = self.folder / f"{module}-1.2.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.2\n")
        text = "".join(f"[candata.{group}]\n{point}\n" for group, point in points.items())
        (info / "entry_points.txt").write_text(text)

    def run(self, *words: str) -> subprocess.CompletedProcess:
        """Run candata where these packages are installed."""
        return self.python("-m", "candata_cli.main", *words)

    def python(self, *words: str) -> subprocess.CompletedProcess:
        """Run Python where these packages are installed."""
        env = {**os.environ, "PYTHONPATH": f"{self.folder}{os.pathsep}{ROOT}"}
        return subprocess.run([sys.executable, *words], env=env, capture_output=True, text=True, check=False)


@pytest.fixture
def site(tmp_path) -> Site:
    """An empty folder on the path."""
    return Site(tmp_path)


def test_a_plug_in_is_listed_with_its_package(site):
    site.install("candata-mass", {"effects": "mass_again = candata_mass:EFFECT"}, EFFECT)
    done = site.run("list", "effects", "--json")
    assert done.returncode == 0, done.stderr
    rows = {row["name"]: row for row in json.loads(done.stdout)}
    wanted = {"kind": "effects", "name": "mass_again", "package": "candata-mass 1.2", "about": "mass again"}
    assert rows["mass_again"] == wanted
    assert rows["object_mass"]["package"] == "candata"


BROKEN = {
    "a name that is built in": (
        {"effects": "object_mass = candata_bad:EFFECT"},
        EFFECT,
        "effect 'object_mass' of package candata-bad 1.2 cannot be used\n"
        "  expected: a name of its own\n"
        "  found: it is built in\n",
    ),
    "a module that does not import": (
        {"effects": "wind = candata_bad:EFFECT"},
        "import no_such_module",
        "effect 'wind' of package candata-bad 1.2 cannot be used\n"
        "  expected: candata_bad:EFFECT of type Effect\n"
        "  found: ModuleNotFoundError: No module named 'no_such_module'\n",
    ),
    "a module with an error": ({"effects": "wind = candata_bad:EFFECT"}, "1 / 0", "found: ZeroDivisionError"),
    "no such constant": ({"effects": "wind = candata_bad:EFFECT"}, "", "found: AttributeError"),
    "another constant": ({"effects": "wind = candata_bad:EFFECT"}, "EFFECT = 3", "  found: int\n"),
}


@pytest.mark.parametrize(("points", "code", "words"), BROKEN.values(), ids=list(BROKEN))
def test_a_broken_plug_in_is_one_clear_error_and_breaks_nothing_else(site, points, code, words):
    site.install("candata-bad", points, code)
    listed = site.run("list", "effects")
    assert listed.returncode == 3
    assert words in listed.stderr
    assert "Traceback" not in listed.stderr
    assert "object_mass" in [line.split()[1] for line in listed.stdout.splitlines()]
    assert site.run("--version").returncode == 0
    names = site.python("-c", "from candata.effects import effect, effect_names; print(len(effect_names()))")
    assert names.returncode == 0, names.stderr
    assert names.stderr.count("of package candata-bad 1.2 cannot be used") == 1, "it is said once"
    built_in = site.python("-W", "error", "-c", "from candata.effects import effect; effect('object_mass')")
    assert built_in.returncode == 0, built_in.stderr


def test_two_packages_that_bring_one_name_are_both_named(site):
    for package in ("candata-first", "candata-second"):
        site.install(package, {"effects": f"wind = {package.replace('-', '_')}:EFFECT"}, EFFECT)
    done = site.run("list", "effects")
    assert done.returncode == 3
    assert "candata-first 1.2" in done.stderr
    assert "candata-second 1.2" in done.stderr


def test_a_command_that_needs_a_broken_plug_in_says_which_package(site):
    site.install("candata-bad", {"formats": "odd = candata_bad:FORMAT"}, "import no_such_module")
    done = site.run("import", "odd", "somewhere", "--out", "nowhere")
    assert done.returncode == 3
    assert done.stderr.startswith("format 'odd' of package candata-bad 1.2 cannot be used\n")
    exported = site.run("export", "nothing", "somewhere", "--out", "nowhere")
    assert exported.returncode == 2, "an unknown name is a usage error, whatever else is broken"
    assert "format 'odd' of package candata-bad 1.2 cannot be used\n" in exported.stderr
    assert "PluginWarning" not in exported.stderr


def test_a_built_in_name_asks_no_other_package(site):
    code = """
import importlib.metadata
from candata.formats import FORMATS
from candata.policies import policy
from candata.scenes import load_scene
def forbidden(*words, **named): raise SystemExit("other packages were asked")
importlib.metadata.entry_points = forbidden
FORMATS.load("table"), policy("push"), load_scene("cube_toss")
"""
    done = site.python("-c", code)
    assert done.returncode == 0, done.stderr


def test_every_kind_has_a_registry_and_an_unknown_kind_lists_them(site):
    done = site.run("list", "effect")
    assert done.returncode == 2
    assert "checks, devices, effects, formats, models, objects, policies, scenes" in done.stderr
