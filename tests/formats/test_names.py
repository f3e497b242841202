"""Elements get the names that their columns share with other channels."""

import pytest

from candata.formats._names import element_names, fingertip_names


@pytest.mark.parametrize(
    ("channel", "columns", "names"),
    [
        ("joint_position", ["q_thumb_bend", "q_thumb_rot"], ("thumb_bend", "thumb_rot")),
        ("joint_position", ["q_elbow"], ("elbow",)),
        ("joint_position", ["thumb_bend", "thumb_rot"], ("thumb_bend", "thumb_rot")),
        ("joint_position", ["joint_position.a", "joint_position.b"], ("a", "b")),
        ("joint_position", ["q_a", "b"], ("q_a", "b")),
        ("joint_position", ["q1", "q2"], ("q1", "q2")),
        ("joint_position", ["a_x", "a_y"], ("a_x", "a_y")),
        ("action", ["a_x", "a_y"], ("x", "y")),
        ("action", ["cmd/x", "cmd/y"], ("x", "y")),
        ("joint_velocity", ["dq_x"], ("x",)),
        ("joint_effort", ["tau_x"], ("x",)),
        ("object_pose", ["q_x"], ("q_x",)),
    ],
)
def test_a_shared_first_word_goes(channel, columns, names):
    assert element_names(channel, columns) == names


@pytest.mark.parametrize(
    ("triples", "names"),
    [
        ([("f0_x", "f0_y", "f0_z"), ("f1_x", "f1_y", "f1_z")], ("f0", "f1")),
        ([("force_thumb_x", "force_thumb_y", "force_thumb_z")], ("thumb",)),
        ([("fx_thumb", "fy_thumb", "fz_thumb"), ("fx_index", "fy_index", "fz_index")], ("thumb", "index")),
        ([("a", "b", "c"), ("d", "e", "g")], ("f0", "f1")),
        ([("tip.fx", "tip.fy", "tip.fz"), ("end.fx", "end.fy", "end.fz")], ("tip", "end")),
        ([("tip_fx", "tip_fy", "tip_fz"), ("stiff_x", "stiff_y", "stiff_z")], ("tip", "stiff")),
    ],
)
def test_a_fingertip_is_what_its_columns_share(triples, names):
    assert fingertip_names(triples) == names
