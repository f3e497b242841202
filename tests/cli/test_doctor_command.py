from __future__ import annotations

import json
import sys

import pytest
import typer
from typer.testing import CliRunner

from candata import __version__
from candata.errors import UsageError
from candata_cli import _environment
from candata_cli.doctor_command import register

app = typer.Typer()
register(app)


def run(*arguments):
    return CliRunner().invoke(app, list(map(str, arguments)))


@pytest.fixture(autouse=True)
def light(monkeypatch):
    """Loading torch takes seconds and tells nothing here."""
    monkeypatch.setattr(_environment, "gpus", lambda: ["a GPU"])


def test_versions_extras_and_devices(monkeypatch):
    monkeypatch.setattr(_environment, "version_of", lambda name: None if name == "obstore" else "1.2")
    monkeypatch.setattr(_environment, "serial_ports", lambda: None)
    result = run()
    assert result.exit_code == 0
    assert f"candata                    {__version__}\n" in result.stdout
    assert "extra formats: complete\n" in result.stdout
    assert 'extra remote: lacks obstore: pip install "candata[remote]"\n' in result.stdout
    assert "serial ports: unknown without pyserial\nGPUs: a GPU\n" in result.stdout
    assert "extra test" not in result.stdout


def test_json_has_every_key(tmp_path):
    result = run(tmp_path, "--quick", "--json")
    assert result.exit_code == 0
    found = json.loads(result.stdout)
    assert list(found) == ["versions", "extras", "devices", "machine", "folder", "ok"]
    assert found["versions"]["numpy"][0].isdigit()
    assert found["machine"]["processors"] >= 1
    assert [probe["name"] for probe in found["folder"] if probe["ok"] is None] == ["kill test"]
    assert json.loads(run("--json").stdout)["folder"] is None
    assert list(tmp_path.iterdir()) == []


def test_a_package_that_is_needed_and_missing_exits_1(monkeypatch):
    monkeypatch.setattr(_environment, "version_of", lambda name: None if name == "mujoco-core" else "1.2")
    result = run()
    assert result.exit_code == 1
    assert "mujoco-core                missing\n" in result.stdout


def test_a_folder_that_fails_exits_1_and_says_what_to_do(tmp_path, monkeypatch):
    from candata.datasets import probe

    monkeypatch.setattr(probe, "LEAST_FREE_BYTES", 10**18)
    result = run(tmp_path, "--quick")
    assert result.exit_code == 1
    assert "space               FAILED" in result.stdout
    assert "do: space: free at least" in result.stdout


def test_wrong_arguments(tmp_path):
    assert isinstance(run(tmp_path / "none").exception, UsageError)
    assert run(tmp_path, "--kills", 0).exit_code == 2


def test_what_is_needed_is_read_from_the_package_or_the_checkout(monkeypatch):
    lines = ["numpy>=2.0", 'h5py>=3; extra == "formats"', 'pytest; extra == "test"', "candata[x]; extra == 'dev'"]
    monkeypatch.setattr(_environment.metadata, "requires", lambda name: lines)
    assert _environment.needs() == {None: ("numpy",), "formats": ("h5py",)}

    def missing(name):
        raise _environment.metadata.PackageNotFoundError

    monkeypatch.setattr(_environment.metadata, "requires", missing)
    found = _environment.needs()
    assert "numpy" in found[None]
    assert found["query"] == ("duckdb",)
    monkeypatch.setattr(_environment, "__file__", "/nowhere/candata_cli/_environment.py")
    assert _environment.needs() == {}


def test_a_missing_package_is_no_device_list(monkeypatch):
    monkeypatch.setitem(sys.modules, "serial.tools", None)
    assert _environment.serial_ports() is None
