"""A user's model is loaded in a process of its own first: known after that, and never the end of the user's process."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from candata.errors import CandataError, DataError, SceneError, SetupError, UsageError
from candata.scenes import load_scene

ROOT = Path(__file__).resolve().parents[2]
ARM = '<body name="arm"><joint name="bend"/><geom name="tip" size=".01"/></body>'
MESH = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
SCENE = "model: {}\nrate_hz: 100\njoints: [bend]\n"


def mjcf(inside: str = "", assets: str = "", option: str = "", compiler: str = "", after: str = "") -> str:
    """A model of one joint, and what is given."""
    return (
        f"<mujoco><compiler {compiler}/><option {option}/><asset>{assets}</asset>"
        f"<worldbody>{ARM}{inside}</worldbody>{after}</mujoco>"
    )


def put(folder: Path, text: str, name: str = "a.xml") -> Path:
    """Write a model and its scene file; return the scene file."""
    (folder / name).write_text(text)
    (folder / "scene.yaml").write_text(SCENE.format(name))
    return folder / "scene.yaml"


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch) -> Path:
    """An empty cache, and the folder in which the known models are."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "candata" / "models"


@pytest.fixture
def folder(tmp_path) -> Path:
    """A folder for a scene."""
    (tmp_path / "scene").mkdir()
    return tmp_path / "scene"


@pytest.fixture
def no_process(monkeypatch):
    """From when it is called, no process can be started: only what is known loads."""
    return lambda: monkeypatch.setattr(sys, "executable", "/nowhere/python")


def refusal(scene: Path) -> list[str]:
    """The lines of the error."""
    with pytest.raises(SceneError) as caught:
        load_scene(scene)
    return str(caught.value).splitlines()


def test_a_known_model_needs_no_process(folder, no_process):
    scene = put(folder, mjcf())
    first = load_scene(scene)
    no_process()
    assert load_scene(scene).digest == first.digest
    (folder / "a.xml").write_text(mjcf('<geom size="1"/>'))
    with pytest.raises(SetupError, match=r"the process that loads model a\.xml first does not start"):
        load_scene(scene)


def test_a_known_model_is_known_in_another_folder(folder, tmp_path, no_process):
    put(folder, mjcf())
    load_scene(folder / "scene.yaml")
    no_process()
    shutil.copytree(folder, tmp_path / "copy")
    assert load_scene(tmp_path / "copy/scene.yaml").file.joints == ("bend",)


PARTS = {
    "included": ('<include file="b.xml"/>', "", "b.xml", "<mujocoinclude><geom size='.1'/></mujocoinclude>"),
    "mesh": ('<geom type="mesh" mesh="m"/>', "<mesh file='m.obj'/>", "m.obj", MESH),
    "mesh in the folder of the compiler": ('<geom type="mesh" mesh="m"/>', "<mesh file='m.obj'/>", "parts/m.obj", MESH),
    "mesh named by entities": ('<geom type="mesh" mesh="m"/>', "<mesh name='m' file='m&#46;obj'/>", "m.obj", MESH),
    "attached": ("", "<model name='x' file='b.xml'/>", "b.xml", "<mujoco><worldbody/></mujoco>"),
}


@pytest.mark.parametrize("part", PARTS)
def test_a_model_one_of_whose_files_changed_is_new(folder, no_process, part):
    inside, assets, name, text = PARTS[part]
    (folder / "parts").mkdir()
    (folder / name).write_text(text)
    scene = put(folder, mjcf(inside, assets, compiler='meshdir="parts"' if "/" in name else ""))
    load_scene(scene)
    no_process()
    load_scene(scene)
    (folder / name).write_text(text + " ")
    with pytest.raises(SetupError):
        load_scene(scene)
    (folder / name).write_text(text)
    load_scene(scene)


def test_the_files_of_an_included_and_of_an_attached_file_count(folder, no_process):
    (folder / "meshes").mkdir()
    (folder / "other/meshes").mkdir(parents=True)
    for mesh in ("meshes/b.obj", "other/meshes/c.obj"):
        (folder / mesh).write_text(MESH)
    (folder / "b.xml").write_text('<mujocoinclude><asset><mesh file="b.obj"/></asset></mujocoinclude>')
    (folder / "other/c.xml").write_text(
        '<mujoco><compiler meshdir="meshes"/><asset><mesh file="c.obj"/></asset>'
        '<worldbody><body name="c"><geom type="mesh" mesh="c"/></body></worldbody></mujoco>'
    )
    inside = '<geom type="mesh" mesh="b"/><frame><attach model="x" body="c" prefix="x_"/></frame>'
    text = mjcf(inside, '<model name="x" file="other/c.xml"/>', compiler='meshdir="meshes"')
    scene = put(folder, text.replace("<asset>", '<include file="b.xml"/><asset>', 1))
    assert load_scene(scene).model.nmesh == 2
    no_process()
    for mesh in ("meshes/b.obj", "other/meshes/c.obj"):
        (folder / mesh).write_text(MESH + " ")
        with pytest.raises(SetupError):
            load_scene(scene)
        (folder / mesh).write_text(MESH)
    load_scene(scene)


def test_the_meshes_of_a_urdf_count(folder, no_process):
    (folder / "pkg/urdf").mkdir(parents=True)
    (folder / "pkg/m.obj").write_text(MESH)
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    mesh = '<collision><geometry><mesh filename="package://pkg/m.obj"/></geometry></collision>'
    scene = put(
        folder / "pkg/urdf",
        f'<robot name="r"><link name="base"/><link name="link">{inertial}{mesh}</link><joint name="bend" '
        'type="continuous"><parent link="base"/><child link="link"/><axis xyz="0 1 0"/></joint></robot>',
        "a.urdf",
    )
    load_scene(scene)
    no_process()
    load_scene(scene)
    (folder / "pkg/m.obj").write_text(MESH + " ")
    with pytest.raises(SetupError):
        load_scene(scene)


def test_a_damaged_record_costs_another_first_load(folder, cache, no_process):
    scene = put(folder, mjcf())
    load_scene(scene)
    (record,) = cache.iterdir()
    whole = record.read_bytes()
    record.write_bytes(whole[:-1])
    load_scene(scene)
    assert record.read_bytes() == whole
    record.write_bytes(b"")
    no_process()
    with pytest.raises(SetupError):
        load_scene(scene)


def test_no_cache_can_be_kept(folder, cache):
    cache.parent.parent.write_text("a file")
    scene = put(folder, mjcf())
    for _ in range(2):
        assert load_scene(scene).file.joints == ("bend",)


def test_what_is_refused_is_not_known(folder, cache):
    assert refusal(put(folder, mjcf('<geom size="-1"/>')))[0].startswith("scene ")
    assert not cache.exists()


@pytest.mark.parametrize(
    ("text", "first"),
    [
        (mjcf(option='gravity="0 0 nan"'), "model a.xml cannot be simulated"),
        (mjcf('<body pos="nan 0 0"><geom size=".1"/></body>'), "model a.xml cannot be simulated"),
        (mjcf('<body><joint stiffness="nan"/><geom size=".1"/></body>'), "model a.xml cannot be simulated"),
        (mjcf(after='<size memory="900T"/>'), "model a.xml takes more than 4 GB of memory while it is compiled"),
        (mjcf(option='timestep="1e-9"'), "scene {scene}: the physics step is too short to simulate"),
        (mjcf(option='timestep="nan"'), "scene {scene}: the physics step is no time"),
        (mjcf('<body><joint/><geom size=".1" mass="0"/></body>'), "scene {scene} does not compile: Error: mass and"),
        (mjcf(after='<keyframe><key qpos="1 2 3"/></keyframe>'), "scene {scene} does not compile: Error: "),
    ],
)
def test_one_error_and_nothing_left_behind(folder, monkeypatch, capfd, text, first):
    monkeypatch.chdir(folder)
    scene = put(folder, text)
    assert refusal(scene)[0].startswith(first.format(scene=scene))
    assert sorted(os.listdir(folder)) == ["a.xml", "scene.yaml"]
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("asset", ['<mesh name="m" file="x.stl"/>', '<hfield name="h" file="x.stl" size="1 1 1 1"/>'])
def test_a_fifo_in_place_of_a_file(folder, asset):
    os.mkfifo(folder / "x.stl")
    lines = refusal(put(folder, mjcf(assets=asset)))
    assert lines[0] == "x.stl, which the model names, is no file"
    assert lines[2] == "  found: a FIFO"


def test_a_fifo_in_place_of_the_model(folder):
    scene = put(folder, mjcf())
    (folder / "a.xml").unlink()
    os.mkfifo(folder / "a.xml")
    assert refusal(scene)[0] == "model a.xml is a FIFO, no file"


def test_a_device_in_place_of_a_file(folder):
    lines = refusal(put(folder, mjcf(assets='<texture name="t" type="2d" file="/dev/zero"/>')))
    assert lines[0] == "zero, which the model names, is no file"


def test_files_larger_than_any_model(folder):
    scene = put(folder, mjcf(assets='<mesh name="m" file="m.stl"/>'))
    (folder / "m.stl").touch()
    os.truncate(folder / "m.stl", 1 << 40)
    assert refusal(scene)[:2] == [
        "model a.xml is too large to simulate",
        "  expected: at most 1,073,741,824",
    ]
    os.truncate(folder / "a.xml", 1 << 28)
    assert refusal(scene)[0] == "model a.xml is too large to simulate"


def test_files_that_name_one_another_for_ever(folder):
    include = '<mujocoinclude><include file="{}"/></mujocoinclude>'
    for k in range(100):
        (folder / f"{k}.xml").write_text(include.format(f"{k + 1}.xml"))
    lines = refusal(put(folder, mjcf('<include file="0.xml"/>')))
    assert lines[1:3] == ["  expected: at most 50 deep", "  found: files that name one another"]


def test_two_files_that_include_one_another(folder):
    (folder / "b.xml").write_text('<mujocoinclude><include file="a.xml"/></mujocoinclude>')
    assert "already included" in refusal(put(folder, mjcf('<include file="b.xml"/>')))[0]


def test_a_model_that_crashes_mujoco(folder):
    text = mjcf("<!-- @ -->", '<model name="x" file="a.xml"/>').encode().replace(b"@", b"\xff")
    scene = put(folder, "")
    (folder / "a.xml").write_bytes(text)
    lines = refusal(scene)
    assert lines[0] == "model a.xml crashes MuJoCo"
    assert lines[2] == "  found: SIGSEGV while it is read"


def test_a_file_whose_name_is_not_utf_8(folder):
    scene = put(folder, "")
    (folder / "a.xml").write_bytes(mjcf(assets='<mesh name="m" file="@.stl"/>').encode().replace(b"@", b"\xff"))
    assert refusal(scene)[0] == "model a.xml has a name that is not UTF-8"


BUSY = mjcf('<replicate count="9000" offset="0 0 1"><body><joint/><geom size=".1"/></body></replicate>')


def test_a_model_that_takes_too_long(folder, monkeypatch, caplog):
    monkeypatch.setenv("CANDATA_MODEL_SECONDS", "0.4")
    lines = refusal(put(folder, BUSY))
    assert re.match(r"model a\.xml takes more than (0\.4 s of processor time|1\.2 s) while it is ", lines[0])
    assert lines[-1].endswith("or allow more: CANDATA_MODEL_SECONDS=NUMBER")


def test_a_model_that_takes_too_much_memory(folder, monkeypatch):
    texture = '<texture name="t" type="2d" builtin="flat" width="9000" height="9000"/>'
    scene = put(folder, mjcf(assets=texture))
    if not Path("/proc/self/statm").exists():
        pytest.skip("this system does not bound the memory of a process")
    monkeypatch.setenv("CANDATA_MODEL_GB", "0.2")
    lines = refusal(scene)
    assert lines[0] == "model a.xml takes more than 0.2 GB of memory while it is compiled"
    assert lines[-1].endswith("or allow more: CANDATA_MODEL_GB=NUMBER")


@pytest.mark.parametrize("text", ["soon", "0", "-1", "nan", "inf"])
def test_a_limit_that_is_none(folder, monkeypatch, text):
    monkeypatch.setenv("CANDATA_MODEL_SECONDS", text)
    with pytest.raises(UsageError, match="CANDATA_MODEL_SECONDS is no limit"):
        load_scene(put(folder, mjcf()))


SCRIPT = """
from candata import load_scene
print(load_scene({!r}).file.joints)
"""


def ran(words: list[str], text: str, cwd: Path, **variables: str) -> str:
    """What a Python prints that runs a text; its own environment does not name this checkout."""
    env = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | variables
    text = f"import sys; sys.path[:0] = {[str(ROOT)]!r}\n{text}"
    done = subprocess.run(
        [sys.executable, *words, text], capture_output=True, text=True, cwd=cwd, env=env, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_an_isolated_program_loads_a_model(folder):
    assert ran(["-I", "-c"], SCRIPT.format(str(put(folder, mjcf()))), folder) == "('bend',)\n"


def test_a_script_without_a_guard_loads_a_model(folder):
    (folder / "mine.py").write_text(SCRIPT.format(str(put(folder, mjcf()))))
    assert ran(["-c"], "import runpy; runpy.run_path('mine.py', run_name='__main__')", folder) == "('bend',)\n"


def test_a_program_whose_folder_is_gone_loads_a_model(folder, tmp_path):
    scene = put(folder, mjcf())
    (tmp_path / "gone").mkdir()
    text = SCRIPT.format(str(scene)).replace("print", "import os; os.rmdir(os.getcwd())\nprint")
    assert ran(["-c"], text, tmp_path / "gone") == "('bend',)\n"


@pytest.mark.hard
def test_many_processes_at_once(folder):
    scene = put(folder, mjcf())
    text = f"import sys; sys.path[:0] = {[str(ROOT)]!r}\n{SCRIPT.format(str(scene))}"
    many = [subprocess.Popen([sys.executable, "-c", text], stdout=subprocess.PIPE, text=True) for _ in range(8)]
    assert {process.communicate(timeout=300)[0] for process in many} == {"('bend',)\n"}


def children(pid: int) -> list[int]:
    """The processes that a process started."""
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def is_running(pid: int) -> bool:
    """Tell whether a process runs; one that has ended may still be listed."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.hard
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="asks /proc for children")
def test_ctrl_c_ends_a_first_load(folder):
    put(folder, BUSY)
    env = os.environ | {"PYTHONPATH": str(ROOT), "CANDATA_MODEL_SECONDS": "600"}
    command = [sys.executable, "-m", "candata_cli.main", "scene", "show", "scene.yaml"]
    # A job in the background of a shell ignores Ctrl-C, and so would what it starts.
    heard = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)}
    with subprocess.Popen(command, cwd=folder, env=env, stderr=subprocess.PIPE, text=True, **heard) as process:
        assert process.stderr is not None
        assert (
            process.stderr.readline()
            == "model a.xml is loaded in a process of its own first, for at most 600 s of processor time\n"
        )
        (child,) = children(process.pid)
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=60) == 130
        assert "Traceback" not in process.stderr.read()
    assert not is_running(child)


@pytest.mark.hard
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="asks /proc for children")
def test_a_first_load_that_the_system_ends(folder):
    put(folder, BUSY)
    env = os.environ | {"PYTHONPATH": str(ROOT), "CANDATA_MODEL_SECONDS": "600"}
    command = [sys.executable, "-m", "candata_cli.main", "scene", "show", "scene.yaml"]
    with subprocess.Popen(command, cwd=folder, env=env, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        process.stderr.readline()
        os.kill(children(process.pid)[0], signal.SIGKILL)
        said = process.stderr.read()
    assert process.returncode == 2
    assert said.startswith("model a.xml crashes MuJoCo\n")


def test_a_pointer_among_the_files(folder):
    (folder / "m.obj").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 12\n")
    with pytest.raises(DataError, match=r"m\.obj is a Git LFS pointer"):
        load_scene(put(folder, mjcf(assets='<mesh file="m.obj"/>')))


def test_a_built_in_scene_needs_no_process(no_process):
    no_process()
    assert load_scene("cube_toss").file.object


def test_errors_stay_in_the_order_of_before(folder):
    scene = put(folder, mjcf('<geom size="-1"/>'))
    scene.write_text(SCENE.format("a.xml").replace("bend", "none"))
    with pytest.raises(CandataError, match="none"):
        load_scene(scene)
