"""The frame of a page: one HTML file with its style, its script and its figures inside."""

from __future__ import annotations

import json
from html import escape
from typing import Any

from candata.reports.style import PLOTLY_SCRIPT, SCRIPT, STYLE


def document(title: str, tone: str, body: str, scripts: str = f"<script>{SCRIPT}</script>", style: str = STYLE) -> str:
    """Return the whole page; it asks for nothing from elsewhere.

    Parameters
    ----------
    title : str
        Of the browser's tab.
    tone : str
        Colour of the headline, a name in `style.COLOURS`.
    body : str
        HTML.
    scripts : str
        Script elements that end the page.
    style : str
        Style sheet.
    """
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>{escape(title)}</title><style>{style}</style></head>'
        f'<body style="--tone:var(--{tone})"><main>{body}</main>{scripts}</body></html>\n'
    )


def plotly(specs: dict[str, dict[str, Any]]) -> str:
    """Return the scripts that draw Plotly specifications into the boxes of their ids."""
    from plotly.offline import get_plotlyjs

    return (
        f'<script type="application/json" id="figures">{_json(specs)}</script>'
        f"<script>{get_plotlyjs()}</script><script>{PLOTLY_SCRIPT}</script>"
    )


def figure(title: str, sub: str, inner: str) -> str:
    """Return a framed figure with its title and one line on how to read it."""
    return f'<figure><h3>{escape(title)}</h3><p class="sub">{escape(sub)}</p>{inner}</figure>'


def plot(name: str, specs: dict[str, dict[str, Any]]) -> str:
    """Return the empty box that the script draws a figure into, at its final height."""
    return f'<div id="{name}" style="height:{specs[name]["layout"]["height"]}px"></div>'


def _json(specs: dict[str, dict[str, Any]]) -> str:
    """Return the specifications as JSON that cannot end its script element."""
    return json.dumps(specs, allow_nan=False, separators=(",", ":")).replace("</", "<\\/")
