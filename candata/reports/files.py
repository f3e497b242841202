"""A diagnosis as files: report.json, effects.yaml, report.html, and what to do next or instead where it is proposed."""

from __future__ import annotations

import textwrap
from pathlib import Path

import yaml

from candata.datasets.writing import write_text
from candata.gap import Diagnosis
from candata.gap.verdict.proposal import MOTION_FILE
from candata.policies import write_motions
from candata.reports.advice import EFFECTS_FILE, ReportContext
from candata.reports.mjcf_lines import mjcf_lines
from candata.reports.page import write_report
from candata.reports.words import calibration_sentence
from candata.scenes import Scene
from candata.schema.effect import EffectsFile

#: The repaired simulator with a force for what is not known: runs like `effects.yaml`.
STOPGAP = "learned_residual.yaml"
#: The joint fit that claims no names: runs and is exported like `effects.yaml`.
CALIBRATION = "calibration.yaml"
#: Columns of a comment in a file.
COMMENT_WIDTH = 98


def write_diagnosis(diagnosis: Diagnosis, scene: Scene, out: Path, context: ReportContext | None = None) -> Path:
    """Return the path of `report.html` after writing it, `report.json` and `effects.yaml` into `out`.

    `motion.parquet` stands beside them where a motion is proposed, `learned_residual.yaml` where a force was fitted to
    what no effect explains, `calibration.yaml` where a joint fit closes more than what is named; those of an earlier
    diagnosis go. Each file appears whole or not at all. `context` is that of `report_context`, made here by default.
    """
    text = effects_text(diagnosis.effects)
    context = context or report_context(diagnosis, scene, out)
    page = write_report(diagnosis.report, diagnosis.evidence, scene.model, out, text, context)
    write_text(out / "report.json", diagnosis.report.model_dump_json(indent=2) + "\n", "report")
    write_text(out / EFFECTS_FILE, text, "report")
    if diagnosis.motion:
        write_motions(out / MOTION_FILE, scene, diagnosis.motion)
    else:
        (out / MOTION_FILE).unlink(missing_ok=True)
    stopgap = None if diagnosis.stopgap is None else effects_text(diagnosis.stopgap)
    for name, content in ((STOPGAP, stopgap), (CALIBRATION, _calibration_text(diagnosis))):
        if content is None:
            (out / name).unlink(missing_ok=True)
        else:
            write_text(out / name, content, "report")
    return page


def report_context(diagnosis: Diagnosis, scene: Scene, out: Path) -> ReportContext:
    """Return what advice needs beside the record of a report whose files lie in `out`."""
    return ReportContext(out, scene.file.groups, mjcf_lines(scene, diagnosis))


def _calibration_text(diagnosis: Diagnosis) -> str | None:
    """Return the text of `calibration.yaml`, which begins with what it is and is not; None without a calibration."""
    if diagnosis.calibration is None:
        return None
    sentence = calibration_sentence(diagnosis.report)
    comment = "".join(f"# {line}\n" for line in textwrap.wrap(sentence, COMMENT_WIDTH))
    return comment + effects_text(diagnosis.calibration)


def effects_text(effects: EffectsFile) -> str:
    """Return the text of `effects.yaml`: the repaired simulator."""
    return yaml.safe_dump(effects.model_dump(mode="json"), sort_keys=False)
