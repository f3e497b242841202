"""Pages and their parts from the templates of this room: one HTML file with its style, script and figures inside."""

from __future__ import annotations

from functools import cache

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from candata.reports import words
from candata.reports.numbers import digits, percent


@cache
def _environment() -> Environment:
    """Return the templates, which escape every value that is not markup, and the filters that they know."""
    environment = Environment(
        loader=PackageLoader("candata.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "digits": digits,
        "percent": percent,
        "readable": words.readable_name,
        "typeset": words.keep_units,
    }
    return environment


def render_page(template: str, **values: object) -> str:
    """Return the text of the template `NAME.html.j2` filled in.

    Parameters
    ----------
    template : str
        Name of the template.
    **values
        What its expressions name; text is escaped, markup is not.
    """
    return _environment().get_template(f"{template}.html.j2").render(values)


def render(template: str, **values: object) -> Markup:
    """Return a part of a page: `render_page` as markup, which no template escapes again."""
    return Markup(render_page(template, **values))
