"""What the documents name is there: commands, options, links, anchors, effects, verdicts, formats, public data sets."""

from __future__ import annotations

import re
from typing import get_args

import pytest

from candata import plugins
from candata.schema.report import Verdict
from tests.docs import pages

DOCS = pages.ROOT / "docs"
#: Most lines of the two documents that are read first, and of one decision.
LIMITS = {pages.README: 90, pages.ROOT / "ARCHITECTURE.md": 200, **dict.fromkeys(pages.DECISIONS, 60)}


@pytest.fixture(scope="module")
def application():
    return pages.application()


def every(paths):
    return pytest.mark.parametrize("path", paths, ids=lambda path: str(path.relative_to(pages.ROOT)))


@every(pages.DOCUMENTS)
def test_links_and_anchors_lead_somewhere(path):
    links = [(m["path"], m["anchor"]) for m in pages.LINK.finditer(pages.prose(path))]
    assert [target for target, _ in links if target and not (path.parent / target).exists()] == []
    anchored = [(path.parent / target if target else path, anchor) for target, anchor in links if anchor]
    assert [str(anchor) for target, anchor in anchored if anchor not in pages.anchors(target)] == []


@every(pages.PRESENT)
def test_every_command_and_option_that_is_named_exists(path, application):
    wrong = {" ".join(words): pages.mistakes(words, application) for words in pages.commands_named(path)}
    assert {command: found for command, found in wrong.items() if found} == {}
    assert pages.options_named(path) - pages.all_options(application) == set()


def test_the_check_of_commands_sees_wrong_ones(application):
    shown = "candata gap bnech --out x && candata validate x --depe  # candata nothing\ncandata registry VERB"
    found = [pages.mistakes(words, application) for words in pages.commands_in(shown)]
    assert found == [["no command bnech"], ["no option --depe"], []]


def test_every_command_has_a_place(application):
    told = {" ".join(words) for words in pages.commands_named(DOCS / "commands.md")}
    missing = [" ".join(leaf) for leaf in pages.leaves(application) if not any_begins(told, " ".join(leaf))]
    assert missing == []


def any_begins(told: set[str], command: str) -> bool:
    """Tell whether a command that is told is this one."""
    return any(f"{one} ".startswith(f"{command} ") for one in told)


@every([pages.README, pages.ROOT / "ARCHITECTURE.md", *pages.PAGES, *pages.DECISIONS])
def test_a_page_has_one_title(path):
    levels = [m["level"] for m in pages.HEADING.finditer(pages.prose(path))]
    assert levels.count("#") == 1
    assert levels[0] == "#"


@every(LIMITS)
def test_a_page_that_must_be_short_is(path):
    assert len(pages.read(path).splitlines()) <= LIMITS[path]


def test_the_site_leads_to_every_page():
    navigation = pages.read(pages.ROOT / "mkdocs.yml").split("\nnav:\n", 1)[1].split("\n\n", 1)[0]
    named = set(re.findall(r"[\w/]+\.md", navigation))
    site_pages = {str(page.relative_to(DOCS).with_suffix(".md")) for page in [*pages.PAGES, *pages.NOTEBOOKS]}
    assert site_pages - named == set()


def test_the_architecture_leads_to_every_decision():
    linked = {m["path"] for m in pages.LINK.finditer(pages.prose(pages.ROOT / "ARCHITECTURE.md"))}
    assert [page.name for page in pages.DECISIONS if f"docs/decisions/{page.name}" not in linked] == []


def test_decisions_are_numbered_without_gaps():
    assert [int(path.name[:4]) for path in pages.DECISIONS] == list(range(1, len(pages.DECISIONS) + 1))


def test_every_verdict_is_told():
    assert pages.first_column(DOCS / "diagnosing.md", "verdict") == set(get_args(Verdict))
    assert set(get_args(Verdict)) <= set(re.findall(r"`(\w+)`", pages.prose(DOCS / "concepts.md")))


def test_every_effect_is_listed():
    assert pages.first_column(DOCS / "effects.md", "effect") == set(plugins.names("candata.effects"))


def test_every_public_data_set_is_listed():
    listed = pages.first_column(DOCS / "importing.md", "data set")
    assert {name.replace("-", "_") for name in listed} == set(plugins.names("candata.fetch"))


def test_every_format_is_listed_with_what_it_does():
    told = {
        name.strip("`"): (read != "no", write != "no", "--v21" in write)
        for name, read, write, *_ in pages.table(DOCS / "importing.md", "format")
    }
    formats = [plugins.load("candata.formats", "FORMAT", name) for name in plugins.names("candata.formats")]
    assert told == {f.name: (f.read is not None, f.write is not None, "v21" in f.variants) for f in formats}
