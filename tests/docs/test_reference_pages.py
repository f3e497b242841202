"""The reference of the site names what the code has: commands with options, effects, formats, file fields."""

from __future__ import annotations

import functools

import pytest

from candata import __all__ as public_names
from candata.effects import EFFECTS
from candata.formats import FORMATS
from candata.schema.scene import SceneFile
from tests.docs import pages
from tools import reference_pages


@pytest.fixture(scope="module")
def documents():
    return reference_pages.documents()


def test_every_command_has_a_section_with_its_options(documents):
    text, application = documents["commands.md"], pages.application()
    for words in pages.leaves(application):
        command = functools.reduce(lambda group, word: pages.children(group)[word], words, application)
        section = text.split(f"\n## candata {' '.join(words)}\n", 1)[1].split("\n## ", 1)[0]
        assert [option for option in pages.options_of(command) - {"-h", "--help"} if f"`{option}`" not in section] == []


def test_every_effect_has_its_parameters_with_units(documents):
    for name, effect in EFFECTS.load_all().items():
        section = documents["effects.md"].split(f"\n## {name}\n", 1)[1].split("\n## ", 1)[0]
        for parameter in effect.parameters:
            assert f"| `{parameter.name}` | {parameter.unit} |" in section


def test_formats_public_names_and_file_fields_are_there(documents):
    assert [name for name in FORMATS.names() if f"| `{name}` |" not in documents["formats.md"]] == []
    assert [name for name in public_names if f".{name}\n" not in documents["python.md"]] == []
    section = documents["schemas.md"].split("\n## SceneFile\n", 1)[1].split("\n## ", 1)[0]
    assert [field for field in SceneFile.model_fields if f"| `{field}` |" not in section] == []
