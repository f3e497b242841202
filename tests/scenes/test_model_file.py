"""Model files that are none, and those whose meshes lie where ROS puts them: one clear error, or a scene."""

from __future__ import annotations

import os

import pytest

from candata.errors import CandataError, SceneError, UsageError
from candata.scenes import load_scene
from candata.schema.scene import SceneFile

ARM = '<body name="arm"><joint name="bend"/><geom name="tip" size=".01"/></body>'
MJCF = f"<mujoco><worldbody>{ARM}</worldbody></mujoco>"
MESH = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


def scene_of(model):
    """The scene of a model file, its scene file beside it."""
    file = model.parent / "scene.yaml"
    file.write_text(f"model: {model.name}\nrate_hz: 100\njoints: [bend]\n")
    return load_scene(file)


def refusal(model) -> list[str]:
    """The lines of the error."""
    with pytest.raises(SceneError) as caught:
        scene_of(model)
    return str(caught.value).splitlines()


def put(path, content):
    """Write a file; return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(
    ("name", "content", "first"),
    [
        ("a.xml", b"", "model a.xml is not XML"),
        ("a.xml", b"\x89PNG\r\n\x1a\n\x00", "model a.xml is not XML"),
        ("a.xml", "joints: [bend]\n", "model a.xml is not XML"),
        ("a.urdf", "<robot", "model a.urdf cannot be read: XML parse error"),
        ("a.xml", "<sdf><model name='x'/></sdf>", "model a.xml cannot be read: XML Error: Unrecognized XML model type"),
        ("a.mjb", b"\x01\x02", "model a.mjb is compiled, and a compiled model cannot be added to"),
        ("a.mjcf", MJCF, "model a.mjcf cannot be read: could not find decoder"),
        ("a.xml", MJCF.replace('"arm"', '"\xe9"').encode("latin-1"), "model a.xml has a name that is not UTF-8"),
        (
            "a.xml",
            MJCF.replace(ARM, f'{ARM}<include file="b.xml"/>'),
            "model a.xml cannot be read: XML Error: Error opening",
        ),
        (
            "a.xml",
            MJCF.replace(ARM, f'{ARM}<include file="a.xml"/>'),
            "model a.xml cannot be read: XML Error: File 'a.xml'",
        ),
    ],
)
def test_a_file_that_is_no_model(tmp_path, name, content, first):
    assert refusal(put(tmp_path / name, content))[0].startswith(first)


def test_what_to_do_about_it(tmp_path):
    lines = refusal(put(tmp_path / "a.mjcf", MJCF))
    assert lines[-1].startswith("  do: MuJoCo tells models by their names: call the file .xml (MJCF) or .urdf")
    lines = refusal(put(tmp_path / "a.xml", MJCF.replace(ARM, f'{ARM}<include file="b.xml"/>')))
    assert lines[-1] == "  do: put the file there, or correct its path in the model"
    lines = refusal(
        put(tmp_path / "hand.urdf.xacro", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:a/></robot>')
    )
    assert lines[0] == "model hand.urdf.xacro is xacro, of which a URDF is made"
    assert lines[-1] == "  do: xacro hand.urdf.xacro > hand.urdf"


def test_an_included_file_is_read(tmp_path):
    put(tmp_path / "parts" / "arm.xml", f"<mujocoinclude>{ARM}</mujocoinclude>")
    model = put(tmp_path / "a.xml", MJCF.replace(ARM, '<include file="parts/arm.xml"/>'))
    assert scene_of(model).file.joints == ("bend",)


def test_a_comment_may_have_any_encoding(tmp_path):
    model = put(tmp_path / "a.xml", MJCF.replace(ARM, f"<!-- \xe9 -->{ARM}").encode("latin-1"))
    assert scene_of(model).file.joints == ("bend",)


def attaching(*names: str) -> str:
    """A model that attaches others."""
    assets = "".join(f'<model name="m{i}" file="{name}"/>' for i, name in enumerate(names))
    return MJCF.replace("<worldbody>", f"<asset>{assets}</asset><worldbody>")


def test_a_model_that_attaches_itself(tmp_path):
    lines = refusal(put(tmp_path / "a.xml", attaching("a.xml")))
    assert lines[:2] == ["model a.xml attaches itself", "  found: a.xml -> a.xml"]
    put(tmp_path / "b.xml", attaching("a.xml"))
    assert refusal(put(tmp_path / "a.xml", attaching("b.xml")))[1] == "  found: a.xml -> b.xml -> a.xml"
    put(tmp_path / "b.xml", f'<mujoco><include file="c.xml"/>{ARM[:0]}</mujoco>')
    put(tmp_path / "c.xml", '<mujocoinclude><asset><model name="x" file="a.xml"/></asset></mujocoinclude>')
    assert refusal(put(tmp_path / "a.xml", attaching("b.xml")))[0] == "model a.xml attaches itself"
    put(tmp_path / "b.xml", '<mujoco><include file="a.xml"/></mujoco>')
    assert refusal(put(tmp_path / "a.xml", attaching("b.xml")))[0] == "model a.xml attaches itself"


def test_a_model_may_attach_another_twice(tmp_path):
    put(tmp_path / "b.xml", "<mujoco><worldbody><body name='b'><geom size='.1'/></body></worldbody></mujoco>")
    assert scene_of(put(tmp_path / "a.xml", attaching("b.xml", "b.xml"))).file.joints == ("bend",)


@pytest.mark.parametrize(
    ("part", "found"),
    [
        (
            '<replicate count="1000000000"><geom size=".1"/></replicate>',
            "<replicate> that unfolds to 1,000,000,000 copies",
        ),
        (
            '<replicate count="200"><replicate count="200"><geom size=".1"/></replicate></replicate>',
            "<replicate> that unfolds to 40,000 copies",
        ),
        ('<body><flexcomp name="f" count="900 900 1"/></body>', "<flexcomp> that unfolds to 810,000 copies"),
    ],
)
def test_a_model_that_unfolds_to_too_much(tmp_path, part, found):
    lines = refusal(put(tmp_path / "a.xml", MJCF.replace(ARM, ARM + part)))
    assert lines[0] == "model a.xml is too large to simulate"
    assert lines[2] == f"  found: a {found}"


@pytest.mark.parametrize(
    "asset",
    [
        '<hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/>',
        '<texture name="t" type="2d" builtin="flat" width="100000" height="100000"/>',
    ],
)
def test_a_model_that_no_memory_holds(tmp_path, asset):
    model = put(tmp_path / "a.xml", MJCF.replace("<worldbody>", f"<asset>{asset}</asset><worldbody>"))
    assert "100,000 x 100,000 samples" in refusal(model)[2]


def test_a_model_of_many_copies_is_still_read(tmp_path):
    some = '<replicate count="50" offset="0 0 1"><geom size=".1"/></replicate>'
    assert scene_of(put(tmp_path / "a.xml", MJCF.replace(ARM, ARM + some))).model.ngeom == 51


def urdf(mesh: str) -> str:
    """A URDF of one joint whose link collides by a mesh."""
    inertia = '<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/>'
    return (
        f'<robot name="arm"><link name="base"/><link name="link"><inertial><mass value="1"/>{inertia}</inertial>'
        f'<visual><geometry><mesh filename="{mesh}.dae"/></geometry></visual>'
        f'<collision><geometry><mesh filename="{mesh}"/></geometry></collision></link>'
        '<joint name="bend" type="continuous"><parent link="base"/><child link="link"/><axis xyz="0 1 0"/></joint>'
        "</robot>"
    )


@pytest.mark.parametrize(
    ("file", "mesh", "uri"),
    [
        ("pkg/urdf/arm.urdf", "pkg/meshes/m.obj", "package://pkg/meshes/m.obj"),
        ("pkg/urdf/deep/arm.urdf", "pkg/meshes/m.obj", "package://pkg/meshes/m.obj"),
        ("clone/urdf/arm.urdf", "clone/meshes/m.obj", "package://pkg/meshes/m.obj"),
        ("flat/arm.urdf", "flat/meshes/m.obj", "package://pkg/meshes/m.obj"),
        ("flat/arm.urdf", "flat/pkg/meshes/m.obj", "package://pkg/meshes/m.obj"),
        ("share/pkg/a/b/arm.urdf", "share/pkg/meshes/m.obj", "model://pkg/meshes/m.obj"),
        ("pkg/urdf/arm.urdf", "pkg/meshes/m.obj", "package://pkg/urdf/../meshes/m.obj"),
        ("flat/arm.urdf", "flat/meshes/m.obj", "file://meshes/m.obj"),
        ("flat/arm.urdf", "flat/meshes/m.obj", "file:///home/somebody/ws/src/pkg/meshes/m.obj"),
        ("flat/arm.urdf", "flat/meshes/m.obj", "meshes/m.obj"),
    ],
)
def test_a_mesh_is_found_in_the_folders_of_its_urdf(tmp_path, file, mesh, uri):
    put(tmp_path / mesh, MESH)
    text = urdf(uri)
    scene = scene_of(put(tmp_path / file, text))
    assert scene.model.nmesh == 1
    assert (tmp_path / file).read_text() == text


def test_a_package_is_known_by_its_manifest(tmp_path):
    put(tmp_path / "clone/package.xml", "<package/>")
    put(tmp_path / "clone/meshes/m.obj", MESH)
    assert scene_of(put(tmp_path / "clone/a/b/arm.urdf", urdf("package://pkg/meshes/m.obj"))).model.nmesh == 1


def test_a_mesh_by_an_absolute_url(tmp_path):
    mesh = put(tmp_path / "elsewhere/m.obj", MESH)
    assert scene_of(put(tmp_path / "flat/arm.urdf", urdf(f"file://{mesh}"))).model.nmesh == 1


def test_an_installed_urdf_that_links_to_its_source(tmp_path):
    put(tmp_path / "src/pkg/meshes/m.obj", MESH)
    source = put(tmp_path / "src/pkg/urdf/arm.urdf", urdf("package://pkg/meshes/m.obj"))
    installed = tmp_path / "install/share/pkg/urdf/arm.urdf"
    installed.parent.mkdir(parents=True)
    installed.symlink_to(source)
    (tmp_path / "install/share/pkg/meshes").symlink_to(tmp_path / "src/pkg/meshes")
    assert scene_of(installed).model.nmesh == 1


def test_a_mesh_that_is_not_found_says_where_it_was_looked_for(tmp_path):
    model = put(tmp_path / "pkg/urdf/arm.urdf", urdf("package://pkg/meshes/m.obj"))
    top = tmp_path / "pkg"
    assert refusal(model) == [
        "mesh package://pkg/meshes/m.obj of arm.urdf is not found",
        f"  expected: a file at {top}/meshes/m.obj, {top}/urdf/pkg/meshes/m.obj, {top}/pkg/meshes/m.obj, "
        f"{top}/urdf/meshes/m.obj",
        "  found: nothing there",
        f"  where: {model}",
        f"  do: copy the file to {top}/urdf/meshes/m.obj, or put arm.urdf into its package",
    ]
    put(top / "urdf/meshes/m.obj", MESH)
    assert scene_of(model).model.nmesh == 1


@pytest.mark.parametrize(
    "uri",
    [
        "package://pkg/../secret/m.obj",
        "package://pkg/link/m.obj",
        "file://../secret/m.obj",
        "package://../secret/m.obj",
    ],
)
def test_a_link_or_dots_do_not_lead_out_of_the_package(tmp_path, uri):
    put(tmp_path / "secret/m.obj", MESH)
    model = put(tmp_path / "pkg/arm.urdf", urdf(uri))
    os.symlink(tmp_path / "secret", tmp_path / "pkg/link")
    lines = refusal(model)
    assert lines[0] == f"mesh {uri} of arm.urdf is not found"
    assert lines[2].endswith(f", which a link or `..` leads out of {tmp_path / 'pkg'}")


def test_a_mesh_of_a_format_that_mujoco_does_not_read(tmp_path):
    put(tmp_path / "flat/meshes/m.dae", "<COLLADA/>")
    lines = refusal(put(tmp_path / "flat/arm.urdf", urdf("package://pkg/meshes/m.dae")))
    assert "meshes .stl, .obj or .msh" in lines[-1]


@pytest.mark.parametrize(
    ("name", "said", "do"),
    [
        ("hand.xml", "is a model, which does not say which part plays which role", "candata scene init {}, then give"),
        ("hand.urdf", "is a model, which does not say which part plays which role", "candata scene init {}, then give"),
        ("none.xml", "does not exist", ""),
        (".", "is a folder", ""),
    ],
)
def test_a_path_that_is_no_scene(tmp_path, name, said, do):
    put(tmp_path / "hand.xml", MJCF)
    put(tmp_path / "hand.urdf", urdf("m.obj"))
    path = tmp_path / name
    with pytest.raises(UsageError) as caught:
        load_scene(path)
    lines = str(caught.value).splitlines()
    assert lines[:3] == [
        f"{path} {said}",
        "  expected: a scene.yaml, or the name of a built-in scene",
        f"  where: {path}",
    ]
    assert do.format(path) in "\n".join(lines[3:])


def test_a_scene_file_beside_a_model_is_offered(tmp_path):
    model = put(tmp_path / "hand.xml", MJCF)
    scene_of(model)
    for path in (model, tmp_path):
        with pytest.raises(UsageError, match=rf"do: give {tmp_path}/scene\.yaml"):
            load_scene(path)


def test_a_scene_file_that_is_no_text(tmp_path):
    with pytest.raises(UsageError, match=r"scene\.yaml is no YAML\n  expected: text in UTF-8"):
        load_scene(put(tmp_path / "scene.yaml", "model: \xe9".encode("latin-1")))


def test_a_scene_file_whose_names_yaml_reads_otherwise(tmp_path):
    put(tmp_path / "a.xml", MJCF.replace('"bend"', '"on"'))
    assert load_scene(put(tmp_path / "s.yaml", "model: a.xml\nrate_hz: 100\njoints: [on]\n")).file.joints == ("on",)
    put(tmp_path / "a.xml", MJCF.replace('"bend"', '"1"'))
    with pytest.raises(CandataError, match='put the name in quotes, as "1"'):
        load_scene(put(tmp_path / "s.yaml", "model: a.xml\nrate_hz: 100\njoints: [1]\n"))
    file = load_scene(put(tmp_path / "s.yaml", 'model: a.xml\nrate_hz: 100\njoints: ["1"]\n')).file
    assert file == SceneFile(model="a.xml", rate_hz=100, joints=("1",))
