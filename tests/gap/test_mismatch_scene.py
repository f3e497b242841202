"""A nominal scene that MuJoCo cannot step through the recordings is found before the search."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from candata.errors import DataError
from candata.gap.data.recordings import recordings
from candata.gap.mismatch import timing as module
from candata.gap.mismatch.check import checked, mismatch
from candata.gap.replay.replayer import Replayer
from candata.scenes import load_scene
from tests.gap.conftest import ARM, ROLES


@pytest.mark.parametrize(("bad", "definite"), [(1, False), (3, True)])
def test_a_scene_that_cannot_be_stepped_is_found(arm, arm_episodes, monkeypatch, bad, definite):
    """MuJoCo begins anew from the model's own state where it finds no finite one: no replay means anything then."""
    made = recordings(arm, arm_episodes())
    true = module.rollout

    def failing(*args, **options):
        played = true(*args, **options)
        return replace(played, failed=np.where(np.arange(len(played.failed)) < bad, 40, played.failed))

    monkeypatch.setattr(module, "rollout", failing)
    (one,) = mismatch(Replayer(arm), made)
    assert (one.kind, one.definite) == ("scene_unstable", definite)
    assert f"none in {bad} of 8 episodes that were looked at, first in arm-000 after 0.40 s" in one.found


def test_a_stiff_scene_of_a_users_is_refused(tmp_path, arm_episodes):
    """Explicit steps of 10 ms under a servo's damping that asks for a tenth of that."""
    stiff = ARM.replace('timestep="0.002" integrator="implicitfast"', 'timestep="0.01"')
    stiff = re.sub('kv="[0-9.]*" forcerange="[-0-9 ]*"', 'kv="8"', stiff)
    (tmp_path / "arm.xml").write_text(stiff)
    (tmp_path / "scene.yaml").write_text(ROLES)
    scene = load_scene(tmp_path / "scene.yaml")
    with pytest.raises(DataError, match="unstable") as caught:
        checked(Replayer(scene), recordings(scene, arm_episodes()))
    assert "smaller time step" in str(caught.value.fix)
