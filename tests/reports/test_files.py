"""A diagnosis as files: the record, the repaired simulator, the page, each whole or not at all."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import pytest
import yaml

from candata.errors import SetupError
from candata.gap import Diagnosis
from candata.gap.verdict.figures import Evidence
from candata.reports import effects_text, write_diagnosis
from candata.reports.mjcf_lines import mjcf_lines
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting, EffectsFile
from candata.schema.report import Report

FILES = ["effects.yaml", "report.html", "report.json"]
REPAIRED_SIMULATOR = EffectsFile(
    scene="bench.yaml",
    effects=(
        EffectSetting(name="joint_dry_friction", element="index2", parameters={"frictionloss_Nm": 0.0412}),
        EffectSetting(name="object_com", parameters={"offset_m": (0.01, 0.0, -0.002)}),
        EffectSetting(name="friction_cone", parameters={"cone": "elliptic"}),
    ),
)


@pytest.fixture
def diagnosis(make_report, full_evidence, small_pictures, no_gl) -> Diagnosis:
    return Diagnosis(make_report(), full_evidence, REPAIRED_SIMULATOR)


@pytest.fixture
def scene(hand):
    """All that a page needs of a scene."""
    return SimpleNamespace(model=hand, file=SimpleNamespace(groups={}))


def test_three_files_are_written_into_a_folder_that_is_made(tmp_path, diagnosis, scene):
    out = tmp_path / "deep" / "report"
    assert write_diagnosis(diagnosis, scene, out) == out / "report.html"
    assert sorted(p.name for p in out.iterdir()) == FILES


def test_a_proposed_motion_stands_beside_them_and_goes_with_the_next_diagnosis(tmp_path, diagnosis):
    import numpy as np

    from candata.policies import Motion, read_motions

    world = load_scene("xhand_tabletop")
    motion = Motion("slow reversals", np.repeat(world.model.key_ctrl[:1], 4, axis=0), np.zeros(3))
    write_diagnosis(replace(diagnosis, motion=(motion,)), world, tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([*FILES, "motion.parquet"])
    (motion_read,) = read_motions(tmp_path / "motion.parquet", world).motions
    assert (motion_read.name, motion_read.commands.shape) == ("slow reversals", (4, 15))
    write_diagnosis(diagnosis, world, tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == FILES


def test_the_record_reads_back_as_it_was(tmp_path, diagnosis, scene):
    write_diagnosis(diagnosis, scene, tmp_path)
    text = (tmp_path / "report.json").read_text()
    assert Report.model_validate_json(text) == diagnosis.report
    assert text.endswith("}\n")
    assert "class" in json.loads(text), "the key's public name"


def test_the_effects_read_back_as_they_were(tmp_path, diagnosis, scene):
    write_diagnosis(diagnosis, scene, tmp_path)
    path = tmp_path / "effects.yaml"
    assert EffectsFile.parse(yaml.safe_load(path.read_text()), path) == REPAIRED_SIMULATOR


def test_no_effects_are_an_empty_list():
    assert yaml.safe_load(effects_text(EffectsFile(scene="bench.yaml"))) == {"scene": "bench.yaml", "effects": []}


def test_the_page_holds_the_effects_as_they_are_in_the_file(tmp_path, diagnosis, scene):
    page = write_diagnosis(diagnosis, scene, tmp_path).read_text()
    assert "frictionloss_Nm: 0.0412" in page


def test_a_diagnosis_without_evidence_is_written_too(tmp_path, make_report, scene):
    empty_diagnosis = Diagnosis(make_report("too_little_data"), Evidence(), EffectsFile(scene="bench.yaml"))
    write_diagnosis(empty_diagnosis, scene, tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == FILES


def test_an_older_report_is_replaced(tmp_path, diagnosis, make_report, scene):
    write_diagnosis(diagnosis, scene, tmp_path)
    newer_diagnosis = Diagnosis(make_report("no_gap"), Evidence(), EffectsFile(scene="bench.yaml"))
    write_diagnosis(newer_diagnosis, scene, tmp_path)
    assert Report.model_validate_json((tmp_path / "report.json").read_text()).verdict == "no_gap"
    assert sorted(p.name for p in tmp_path.iterdir()) == FILES


def test_a_file_that_cannot_be_put_in_place_leaves_the_old_one_whole(tmp_path, diagnosis, scene, monkeypatch):
    write_diagnosis(diagnosis, scene, tmp_path)
    text_before = (tmp_path / "report.json").read_text()

    def raise_disk_full(source, target):
        raise OSError("no space left on device")

    monkeypatch.setattr(os, "replace", raise_disk_full)
    with pytest.raises(SetupError, match="no space"):
        write_diagnosis(
            Diagnosis(diagnosis.report.model_copy(update={"verdict": "no_gap"}), Evidence(), REPAIRED_SIMULATOR),
            scene,
            tmp_path,
        )
    assert (tmp_path / "report.json").read_text() == text_before


def test_the_lines_of_the_mjcf_are_those_that_an_export_changes(tmp_path, diagnosis):
    """An element without a name has its place; what MJCF cannot hold has no line; given effects have none either."""
    world = load_scene("cube_toss")
    heavy = EffectSetting(name="object_mass", parameters={"mass_scale": 2.0})
    cone = EffectSetting(name="friction_cone", parameters={"cone": other_cone(world)})
    late = EffectSetting(name="pose_latency", parameters={"latency_s": 0.01})
    lines = mjcf_lines(world, replace(diagnosis, named=(heavy, cone, late)))
    (inertial,) = [line for line in lines if line.startswith("<inertial ")]
    assert re.search(r"<!-- scene\.xml, line \d+ -->$", inertial)
    mass = float(re.search(r'mass="([^"]*)"', inertial).group(1))
    assert mass == pytest.approx(2 * world.model.body_mass[world.model.body("object").id], rel=1e-5)
    assert any(line.startswith(f'<option cone="{other_cone(world)}"') for line in lines)
    assert len(lines) == 2
    assert mjcf_lines(world, replace(diagnosis, named=(late,))) == ()
    given = diagnosis.report.model_copy(update={"given_effects": (heavy,)})
    assert mjcf_lines(world, replace(diagnosis, named=(cone,), report=given)) == ()


def other_cone(scene) -> str:
    """The friction cone that a scene does not have."""
    return "pyramidal" if scene.model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC else "elliptic"
