"""Models that crash, hang or fill memory, by kind, each with what makes it in an empty folder."""

from __future__ import annotations

import os
import random
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

SCENE = "model: {}\nrate_hz: 80\njoints: [j]\nactuators: [a]\nfingertips: [tip]\nobject: o\n"
BODIES = (
    '<body name="b"><joint name="j" type="hinge" axis="0 0 1"/><geom name="tip" size="0.1"/></body>'
    '<body name="o" pos="0 0 0.5"><freejoint/><geom size="0.1"/></body>'
)
TETRAHEDRON = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"

Maker = Callable[[Path], None]


def mjcf(
    inside: str = "", *, bodies: str = BODIES, assets: str = "", option: str = 'timestep="0.0125"', after: str = ""
) -> str:
    """Return an MJCF model: of the world, the assets, the options and what follows the actuator, the text in each."""
    return (
        f"<mujoco><option {option}/><asset>{assets}</asset><worldbody>{inside}{bodies}</worldbody>"
        f'<actuator><position name="a" joint="j"/></actuator>{after}</mujoco>'
    )


def written(content: str | bytes, name: str = "model.xml") -> Maker:
    """Return what writes a model file."""

    def make(folder: Path) -> None:
        (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)

    return make


def with_mesh(content: str | bytes, name: str = "m.stl") -> Maker:
    """Return what writes a model with a mesh file."""

    def make(folder: Path) -> None:
        written(content, name)(folder)
        written(mjcf(f'<geom type="mesh" mesh="{name[0]}"/>', assets=f'<mesh file="{name}"/>'))(folder)

    return make


def stl(triangles: int, *vertices: float) -> bytes:
    """Return a binary STL that says how many triangles it holds; the vertices are those that it does hold."""
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *vertices[k : k + 9], 0) for k in range(0, len(vertices), 9))
    return bytes(80) + struct.pack("<I", triangles) + body


def png_header(width: int, height: int) -> bytes:
    """Return the part of a PNG that says how large it is."""
    part = b"IHDR" + struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0)
    return struct.pack(">I", 13) + part + struct.pack(">I", zlib.crc32(part))


def special(make_file: Callable[[Path], object], asset: str = "") -> Maker:
    """Return what makes a file that is none, as the model or, with an asset that names `x`, beside it."""

    def make(folder: Path) -> None:
        if asset:
            written(mjcf(assets=asset))(folder)
        make_file(folder / ("x" if asset else "model.xml"))

    return make


def attached(deep: int, twice: bool = False) -> Maker:
    """Return what writes models each of which attaches the next, once or twice."""

    def make(folder: Path) -> None:
        for k in range(deep):
            asset = f'<model name="x" file="m{k}.xml"/>' + f'<model name="y" file="m{k}.xml"/>' * twice
            written(mjcf(assets=asset), f"m{k - 1}.xml" if k else "model.xml")(folder)
        written(mjcf(), f"m{deep - 1}.xml")(folder)

    return make


def files(**contents: str | bytes) -> Maker:
    """Return what writes several files; `__` stands for the dot."""

    def make(folder: Path) -> None:
        for name, content in contents.items():
            written(content, name.replace("__", "."))(folder)

    return make


def sparse(size: int, begin: bytes = b"") -> Callable[[Path], None]:
    """Return what makes a file of some bytes that takes no room on a disk."""

    def make(path: Path) -> None:
        path.write_bytes(begin)
        os.truncate(path, size)

    return make


def chain(bodies: int) -> str:
    """Return bodies that hang one from another."""
    return '<body><joint/><geom size=".01"/>' * bodies + "</body>" * bodies


def plugin(name: str) -> str:
    """Return what asks for an engine plugin."""
    return f'<extension><plugin plugin="{name}"/></extension>'


def bomb() -> str:
    """Return a model of entities that unfold to 1e9 words."""
    levels = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 10))
    return f'<!DOCTYPE mujoco [<!ENTITY e0 "lol">{levels}]>' + mjcf(inside="<!-- -->&e9;")


def archive(folder: Path) -> None:
    """Write a zip archive of a model under the name of an MJCF."""
    with zipfile.ZipFile(folder / "model.xml", "w") as zipped:
        zipped.writestr("model.xml", mjcf())


def compiled_model(folder: Path) -> None:
    """Write a compiled model under the name of an MJCF."""
    import mujoco

    mujoco.mj_saveModel(mujoco.MjModel.from_xml_string(mjcf()), str(folder / "model.xml"))


def urdf(mesh: str, mass: str = "1") -> str:
    """Return a URDF of one joint with a mesh."""
    return (
        f'<robot name="r"><link name="base"/><link name="tip"><inertial><mass value="{mass}"/>'
        '<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>'
        f'<collision><geometry><mesh filename="{mesh}"/></geometry></collision></link>'
        '<joint name="j" type="continuous"><parent link="base"/><child link="tip"/><axis xyz="0 1 0"/></joint></robot>'
    )


def many_bodies(count: int) -> str:
    """Return a model of bodies side by side, each written out."""
    return mjcf("".join(f'<body pos="{k} 0 0"><joint/><geom size=".1"/></body>' for k in range(count)))


def odd_names(names: str) -> str:
    """Return a model with bodies, sites, cameras and textures whose names hold what names should not."""
    body = f'<body name="{names}1"><geom name="{names}2" size=".1"/><site name="{names}3"/></body>'
    return mjcf(
        f'{body}<camera name="{names}"/>',
        assets=f'<texture name="{names}" type="2d" builtin="flat" width="1" height="1"/>',
    )


HFIELD = '<geom type="hfield" hfield="h"/>'
STEP = 'timestep="{}"'
CASES: dict[str, Maker] = {
    # crashes
    "attaches itself": written(mjcf(assets='<model name="x" file="model.xml"/>')),
    "two attach one another": files(
        model__xml=mjcf(assets='<model name="x" file="n.xml"/>'),
        n__xml=mjcf(assets='<model name="x" file="model.xml"/>'),
    ),
    "attaches itself, behind a byte of no UTF-8": written(
        mjcf("<!-- @ -->", assets='<model name="x" file="model.xml"/>').encode().replace(b"@", b"\xff")
    ),
    "includes itself": written(mjcf('<include file="model.xml"/>')),
    "two include one another": files(
        model__xml=mjcf('<include file="n.xml"/>'), n__xml='<mujocoinclude><include file="model.xml"/></mujocoinclude>'
    ),
    "bodies nested 1,000 deep": written(mjcf(chain(1000))),
    "bodies nested 30,000 deep": written(mjcf(chain(30_000))),
    "elements nested 1,000,000 deep": written("<mujoco>" * 1_000_000),
    "attached 40 deep": attached(40),
    "attached 2,000 deep": attached(2000),
    "attached 2**40 times": attached(40, twice=True),
    # hangs, memory
    "1e9 copies": written(
        mjcf('<replicate count="1000000000" offset="0 0 1"><body><geom size=".1"/></body></replicate>')
    ),
    "1e9 copies, nested": written(
        mjcf('<replicate count="1000" offset="0 0 1">' * 3 + '<geom size=".1"/>' + "</replicate>" * 3)
    ),
    "9,999 copies": written(
        mjcf('<replicate count="9999" offset="0 0 1"><body><joint/><geom size=".1"/></body></replicate>')
    ),
    "flexcomp of 1e9 points": written(
        mjcf(
            '<body name="g"><flexcomp name="f" count="1000 1000 1000" type="grid" radius=".1" spacing="1 1 1"/></body>'
        )
    ),
    "flexcomp of 20 x 20 x 20 points": written(
        mjcf('<body name="g"><flexcomp name="f" type="grid" dim="3" count="20 20 20" spacing="1 1 1"/></body>')
    ),
    "composite of 1e9 parts": written(mjcf('<composite type="cable" count="1000000000 1 1"/>')),
    "100,000 bodies": written(many_bodies(100_000)),
    "height field of 1e10": written(
        mjcf(HFIELD, assets='<hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/>')
    ),
    "height field of 9e7": written(mjcf(HFIELD, assets='<hfield name="h" nrow="9000" ncol="10000" size="1 1 1 1"/>')),
    "height field file of 1e9": files(
        h__bin=struct.pack("<2i", 30_000, 40_000),
        model__xml=mjcf(HFIELD, assets='<hfield name="h" file="h.bin" size="1 1 1 1"/>'),
    ),
    "texture of 1e10": written(
        mjcf(assets='<texture name="t" type="2d" builtin="flat" width="100000" height="100000"/>')
    ),
    "builtin sphere cut 40 times": written(mjcf(assets='<mesh name="m" builtin="sphere" params="40"/>')),
    "texture drawn on a grid of 1e9": written(
        mjcf(assets='<texture name="t" type="cube" builtin="flat" width="1" height="6" gridsize="1000000000 1"/>')
    ),
    "sensor of 2e9 numbers": written(mjcf(after='<sensor><user dim="2000000000"/></sensor>')),
    "2e9 keyframes": written(mjcf(after='<size nkey="2000000000"/>')),
    "custom number of 2e9": written(mjcf(after='<custom><numeric name="n" size="2000000000"/></custom>')),
    "2e9 starts of a search for contact": written(mjcf(option=STEP.format("0.0125") + ' sdf_initpoints="2000000000"')),
    "-5 copies": written(mjcf('<replicate count="-5"><geom size=".1"/></replicate>')),
    "skin of noise": files(
        x__skn=random.Random(2).randbytes(5000), model__xml=mjcf(after='<deformable><skin file="x.skn"/></deformable>')
    ),
    "picture of 1e10 in its header": files(
        t__png=b"\x89PNG\r\n\x1a\n" + png_header(100_000, 100_000),
        model__xml=mjcf(assets='<texture name="t" type="2d" file="t.png"/>'),
    ),
    "arena of 900 TB": written(mjcf(after='<size memory="900T"/>')),
    "nconmax 2e9": written(mjcf(after='<size nconmax="2000000000" njmax="2000000000"/>')),
    "nuserdata 2e9": written(mjcf(after='<size nuserdata="2000000000"/>')),
    "user data 2e9 a body": written(mjcf(after='<size nuser_body="2000000000"/>')),
    "mesh of 1e9 triangles in its header": with_mesh(stl(1_000_000_000)),
    "mesh of 1e5 equal triangles": with_mesh(stl(100_000, *([0, 0, 0, 1, 0, 0, 0, 1, 0] * 100_000))),
    "mesh of 40,000 random points": with_mesh(
        "".join(f"v {random.Random(k).random()} {k} {k * k % 97}\n" for k in range(40_000)) + "f 1 2 3\nf 1 2 4\n",
        "m.obj",
    ),
    "model file of 1 TB": special(sparse(1 << 40, b"<mujoco>")),
    "mesh file of 1 TB": special(sparse(1 << 40), '<mesh name="m" file="x" content_type="model/stl"/>'),
    "XML bomb": written(bomb()),
    "attribute of 50 MB": written(mjcf(f'<geom name="{"n" * 50_000_000}" size=".1"/>')),
    "solver iterations 1e9": written(
        mjcf(bodies=BODIES.replace("0.5", "0.15"), option='timestep="0.0125" iterations="1000000000" tolerance="0"')
    ),
    "1e9 sensor samples kept": written(
        mjcf(after='<sensor><jointpos joint="j" nsample="1000000000" interval="0.01" delay="1"/></sensor>')
    ),
    # no files
    "FIFO": special(os.mkfifo),
    "FIFO as mesh": special(os.mkfifo, '<mesh name="m" file="x" content_type="model/stl"/>'),
    "FIFO as include": special(os.mkfifo, '<include file="x"/>'),
    "FIFO as height field": special(os.mkfifo, '<hfield name="h" file="x" size="1 1 1 1"/>'),
    "FIFO as attached model": special(os.mkfifo, '<model name="m" file="x"/>'),
    "/dev/zero as model": special(lambda path: path.symlink_to("/dev/zero")),
    "/dev/zero as mesh": special(
        lambda path: path.symlink_to("/dev/zero"), '<mesh name="m" file="x" content_type="model/obj"/>'
    ),
    "/dev/zero as texture": special(
        lambda path: path.symlink_to("/dev/zero"), '<texture name="t" type="2d" file="x" content_type="image/png"/>'
    ),
    "/dev/zero by its own path": written(mjcf(assets='<hfield name="h" file="/dev/zero" size="1 1 1 1"/>')),
    "folder as model": special(Path.mkdir),
    "folder as mesh": special(Path.mkdir, '<mesh name="m" file="x" content_type="model/stl"/>'),
    "link to itself": special(lambda path: path.symlink_to(path)),
    "link to itself as mesh": special(
        lambda path: path.symlink_to(path), '<mesh name="m" file="x" content_type="model/stl"/>'
    ),
    "mesh out of the folder": written(
        mjcf(assets='<mesh name="m" file="../../../../../etc/passwd" content_type="model/obj"/>')
    ),
    "mesh that is missing": written(mjcf(assets='<mesh name="m" file="m.stl"/>')),
    # numbers
    **{
        f"time step {step}": written(mjcf(option=STEP.format(step)))
        for step in ("0", "nan", "1e-9", "-0.0125", "inf", "1e300")
    },
    "gravity NaN": written(mjcf(option='timestep="0.0125" gravity="0 0 nan"')),
    "mass NaN": written(mjcf('<body><joint/><geom size=".1" mass="nan"/></body>')),
    "inertia NaN": written(mjcf('<body><joint/><inertial pos="0 0 0" mass="1" diaginertia="nan 1 1"/></body>')),
    "size NaN": written(mjcf('<body><joint/><geom size="nan"/></body>')),
    "position NaN": written(mjcf('<body pos="nan 0 0"><joint/><geom size=".1"/></body>')),
    "position inf": written(mjcf('<body pos="inf 0 0"><joint/><geom size=".1"/></body>')),
    "quaternion 0": written(mjcf('<body quat="0 0 0 0"><joint/><geom size=".1"/></body>')),
    "stiffness NaN": written(mjcf('<body><joint stiffness="nan" springref="1"/><geom size=".1"/></body>')),
    "solref NaN": written(mjcf('<geom type="plane" size="1 1 1" solref="nan nan" pos="0 0 .45"/>')),
    "mass 0 that moves": written(mjcf('<body><joint/><geom size=".1" mass="0"/></body>')),
    "mass 1e-300": written(mjcf('<body><freejoint/><geom size=".1" mass="1e-300"/></body>')),
    "gain 1e300": written(mjcf(after='<actuator><position name="c" joint="j" kp="1e300" ctrlrange="1 2"/></actuator>')),
    "keyframe of a wrong length": written(mjcf(after='<keyframe><key qpos="1 2 3"/></keyframe>')),
    "unstable first steps": written(
        mjcf('<body><joint stiffness="1e12" springref="1"/><geom size=".1" mass="1e-6"/></body>')
    ),
    "mesh of NaN": with_mesh(stl(4, *([float("nan")] * 36))),
    "mesh of one triangle": with_mesh(stl(1, 0, 0, 0, 1, 0, 0, 0, 1, 0)),
    "mesh with an index of 2e9": with_mesh(TETRAHEDRON + "f 2000000000 1 2\n", "m.obj"),
    "mesh with an index of -9": with_mesh(TETRAHEDRON + "f -9 -8 -7\n", "m.obj"),
    "mesh of no bytes": with_mesh(b""),
    "mesh of noise": with_mesh(random.Random(1).randbytes(5000)),
    "msh of noise": with_mesh(struct.pack("<4i", 1 << 30, 1 << 30, 1 << 30, 1 << 30) + bytes(64), "m.msh"),
    # texts
    "empty": written(b""),
    "noise": written(random.Random(0).randbytes(5000)),
    "noise behind <": written(b"<mujoco>" + random.Random(0).randbytes(5000)),
    "cut off": written(mjcf()[:-60]),
    "UTF-16": written(mjcf().encode("utf-16")),
    "a zero byte within": written(mjcf().replace("<worldbody>", "<worldbody>\0")),
    **{
        f"a name of no UTF-8, {kind}": written(mjcf(inside, assets=assets, after=after).encode().replace(b"@", b"\xff"))
        for kind, inside, assets, after in (
            ("body", '<body name="@"><geom size=".1"/></body>', "", ""),
            ("camera", '<camera name="@"/>', "", ""),
            ("texture", "", '<texture name="@" type="2d" builtin="flat" width="1" height="1"/>', ""),
            ("error", '<geom name="@" size="-1"/>', "", ""),
            ("unknown", '<geom @="1" size="1"/>', "", ""),
            ("file", "", '<mesh name="m" file="@.stl"/>', ""),
            ("exclusion", "", "", '<contact><exclude name="@" body1="b" body2="o"/></contact>'),
        )
    },
    "names with control characters": written(odd_names("a&#10;b&#27;[31m&#9;c")),
    "a name of 1 MB": written(odd_names("n" * 1_000_000)),
    "compiled, called .xml": compiled_model,
    "zip archive, called .xml": archive,
    "engine plugin that is not there": written(mjcf(after=plugin("mujoco.none"))),
    "plugin with noise": written(
        mjcf(
            '<geom type="sdf"><plugin plugin="mujoco.sdf.torus"><config key="radius1" value="x"/></plugin></geom>',
            after=plugin("mujoco.sdf.torus"),
        )
    ),
    "sdf plugin without a mesh": written(
        mjcf('<geom type="sdf" mesh="m"><plugin plugin="mujoco.sdf.torus"/></geom>', after=plugin("mujoco.sdf.torus"))
    ),
    "URDF without its mesh": written(urdf("package://nobody/m.stl"), "model.urdf"),
    "URDF of mass NaN": files(model__urdf=urdf("m.obj", "nan"), m__obj=TETRAHEDRON),
    "URDF whose link is its own parent": written(
        urdf("m.obj").replace('link="base"/><child', 'link="tip"/><child'), "model.urdf"
    ),
}
