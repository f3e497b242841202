"""Recordings of others that their own scene made, kept beside the project: none has a gap."""

from __future__ import annotations

from pathlib import Path

import pytest

from candata.formats.table import read_mapped
from candata.scenes import load_scene
from candata.schema.scene import TableMap
from candata.schema.yaml_text import parse_yaml

CASES = Path(__file__).parents[2].parent / "shared" / "cases"
#: Folders of a scene, a map and a recording of that scene.
NULLS = (
    *("null_still_object", "null_block_apart", "null_ball_apart", "null_pinched_can"),
    *("self_contact", "start_moving", "scene_coupled"),
)


@pytest.mark.slow
@pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not beside the project")
@pytest.mark.parametrize("name", NULLS)
def test_a_recording_of_the_scene_itself_has_no_gap(name, judge):
    source = CASES / name / "map.yaml"
    mapping = TableMap.parse(parse_yaml(source.read_text()), source)
    report = judge(
        load_scene(CASES / name / "scene.yaml"), list(read_mapped(mapping, source.parent / mapping.file))
    ).report
    assert (report.verdict, report.effects) == ("no_gap", ())
