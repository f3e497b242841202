"""What tests of the documents share."""

from __future__ import annotations

import os
import sys

import pytest

from tests.docs import pages


@pytest.fixture
def shell(tmp_path):
    """An environment whose `candata` is this checkout's."""
    script = tmp_path / "bin" / "candata"
    script.parent.mkdir()
    script.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m candata_cli.main "$@"\n')
    script.chmod(0o755)
    path = f"{script.parent}{os.pathsep}{os.environ['PATH']}"
    registry = str(tmp_path / "registry.json")
    return {**os.environ, "PATH": path, "PYTHONPATH": str(pages.ROOT), "CANDATA_REGISTRY": registry}
