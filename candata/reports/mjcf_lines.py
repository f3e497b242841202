"""What named effects change in a scene's MJCF, as lines of XML to be copied."""

from __future__ import annotations

from collections.abc import Sequence

from candata.errors import SceneError, SetupError, UsageError
from candata.gap import Diagnosis
from candata.repair import Change, mjcf_changes
from candata.scenes import Scene

#: Where an element that has no name is found, in files of the user's.
_AT = "<!-- {file}, line {line} -->"


def mjcf_lines(scene: Scene, diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return the elements that the named effects change, a line each, with the attributes that they change alone.

    Empty where nothing is named, where MJCF can hold none of it, where the model cannot be written, and where effects
    were given: the scene then differs from the files that it was read from.
    """
    if not diagnosis.named or diagnosis.report.given_effects:
        return ()
    try:
        changes = mjcf_changes(scene, diagnosis.named)
    except (SceneError, SetupError, UsageError):
        return ()
    by_element: dict[tuple[str, int, str], list[Change]] = {}
    for change in changes:
        by_element.setdefault((change.file, change.line, change.element), []).append(change)
    return tuple(_line(element_changes) for element_changes in by_element.values())


def _line(changes: Sequence[Change]) -> str:
    """Return one element: its tag and name, the attributes that change, and its place where it has no name."""
    tag, _, name = changes[0].element.partition(" ")
    values = {change.attribute: change.after for change in changes if change.after is not None}
    tag, child = values.pop("(tag)", tag), values.pop("(child)", None)
    attributes = {"name": name, **values} if name else values
    text = " ".join([tag, *(f'{attribute}="{value}"' for attribute, value in attributes.items())])
    element = f"<{text}>{child}</{tag}>" if child else f"<{text}/>"
    return element if name else f"{element} {_AT.format(file=changes[0].file, line=changes[0].line)}"
