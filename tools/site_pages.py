"""Hook of MkDocs: pages that do not lie in `docs/`, and links that lead to the same page here and on the site.

README is the first page. ARCHITECTURE, CONTRIBUTING, CHANGELOG, the READMEs of `examples/` and every file that a page
links to are copied to the same path on the site. `reference_pages` writes the reference from the code. A notebook of
`docs/` becomes a page with its outputs.
"""

from __future__ import annotations

import json
import posixpath
import re
from pathlib import Path
from typing import Any

import reference_pages
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
#: Markdown of the repository that has a page though it lies outside `docs/`.
MOUNTED = ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md")
LINK = re.compile(
    r"(?P<text>\[(?:[^\[\]]|\[[^\]]*\])*\])\((?!https?:|mailto:|data:)(?P<path>[^)#\s]*)(?P<anchor>#[^)\s]+)?\)"
)
TEST_TAG = re.compile(r"^<!-- (?:test|not run): [^\n]*-->\n", re.MULTILINE)


def site_path(path: str) -> str:
    """Return the path on the site of a file of the repository, both from their roots."""
    if path == "README.md":
        return "index.md"
    if path.startswith("docs/"):
        path = path.removeprefix("docs/")
        return re.sub(r"\.ipynb$", ".md", path)
    return path


def repository_path(path: str) -> str:
    """Return the path in the repository of a page of the site: what `site_path` undoes."""
    if path == "index.md":
        return "README.md"
    if (ROOT / path).is_file() and not path.startswith("decisions/"):
        return path
    notebook = re.sub(r"\.md$", ".ipynb", path)
    return f"docs/{notebook}" if (ROOT / "docs" / notebook).is_file() else f"docs/{path}"


def target_of(source: str, link: str) -> str:
    """Return the file of the repository that a link of `source` names; a folder stands for its README."""
    target = posixpath.normpath(posixpath.join(posixpath.dirname(source), link))
    readme = f"{target}/README.md"
    return readme if (ROOT / readme).is_file() else target


def site_links(markdown: str, source: str) -> str:
    """Return the text of a page with its links made to lead from page to page of the site.

    A link to a folder without a README keeps its text only.
    """
    here = posixpath.dirname(site_path(source))

    def moved(match: re.Match[str]) -> str:
        if not match["path"]:
            return match[0]
        target = target_of(source, match["path"])
        if (ROOT / target).is_dir():
            return match["text"][1:-1]
        return f"{match['text']}({posixpath.relpath(site_path(target), here or '.')}{match['anchor'] or ''})"

    return LINK.sub(moved, markdown)


def linked_files(pages: list[str]) -> set[str]:
    """Return the files outside `docs/` that pages of the repository link to."""
    found = set()
    for page in pages:
        for match in LINK.finditer((ROOT / page).read_text(encoding="utf-8")):
            target = target_of(page, match["path"]) if match["path"] else page
            if (ROOT / target).is_file() and not target.startswith("docs/"):
                found.add(target)
    return found


def notebook_page(text: str) -> str:
    """Return a notebook as Markdown: its texts, its code, and what the code printed or drew."""
    return "\n\n".join(part for cell in json.loads(text)["cells"] for part in _cell(cell)) + "\n"


def _cell(cell: dict[str, Any]) -> list[str]:
    """Return the Markdown of one cell of a notebook."""
    source = "".join(cell["source"])
    if cell["cell_type"] != "code":
        return [source]
    return [f"```python\n{source}\n```", *(_output(output) for output in cell["outputs"])]


def _output(output: dict[str, Any]) -> str:
    """Return the Markdown of one output: a picture where there is one, else its text."""
    data = output.get("data", {})
    if "image/png" in data:
        return f"![output](data:image/png;base64,{''.join(data['image/png']).strip()})"
    if "text/html" in data:
        return "".join(data["text/html"])
    return f"```text\n{''.join(output.get('text', data.get('text/plain', ''))).rstrip()}\n```"


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the pages of a folder in the place of each entry of the navigation that ends with a slash."""

    def expanded(entry: Any) -> Any:
        if isinstance(entry, list):
            return [expanded(item) for item in entry]
        if isinstance(entry, dict):
            return {title: expanded(value) for title, value in entry.items()}
        if not entry.endswith("/"):
            return entry
        return [site_path(str(path.relative_to(ROOT))) for path in sorted((ROOT / entry).rglob("*.md"))]

    config.nav = expanded(config.nav)
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages and files that do not lie in `docs/`."""
    mounted = [*MOUNTED, *(str(path.relative_to(ROOT)) for path in (ROOT / "examples").rglob("*.md"))]
    pages = [*mounted, *(str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md"))]
    for path in sorted({*mounted, *linked_files(pages)}):
        files.append(File.generated(config, site_path(path), abs_src_path=str(ROOT / path)))
    for notebook in sorted((ROOT / "docs").rglob("*.ipynb")):
        text = notebook_page(notebook.read_text(encoding="utf-8"))
        files.append(File.generated(config, site_path(str(notebook.relative_to(ROOT))), content=text))
    for name, text in reference_pages.documents().items():
        files.append(File.generated(config, f"reference/{name}", content=text))
    for schema in sorted((ROOT / "schemas").glob("*.json")):
        path = str(schema.relative_to(ROOT))
        if files.get_file_from_path(path) is None:
            files.append(File.generated(config, path, abs_src_path=str(schema)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Take the tests' tags off, and make the links of the repository those of the site."""
    text = TEST_TAG.sub("", markdown)
    if page.file.src_uri.startswith("reference/"):
        return text
    return site_links(text, repository_path(page.file.src_uri))
