"""A page as HTML text."""

from __future__ import annotations

from functools import partial

from jinja2 import Environment, PackageLoader, StrictUndefined

from pcdet_avp.visualization.page.embed import embedded_animation, embedded_picture, embedded_video, plays_in_browsers
from pcdet_avp.visualization.page.markdown import inline_html, report_html, table_html
from pcdet_avp.visualization.page.parts import Page

SECTION_LEVEL = 2


def render(page: Page) -> str:
    """One HTML file that needs no other. ConfigError where a file of the page is missing or cannot be read."""
    return _environment().get_template("page.html").render(page=page)


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("pcdet_avp.visualization.page", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(inline=inline_html, anchor=_anchor)
    environment.globals.update(
        table=table_html,
        report=partial(report_html, level=SECTION_LEVEL + 1),
        picture=embedded_picture,
        video=embedded_video,
        animation=embedded_animation,
        plays=plays_in_browsers,
    )
    return environment


def _anchor(title: str) -> str:
    """``What was sent`` -> ``what-was-sent``."""
    return "-".join("".join(c if c.isalnum() else " " for c in title.lower()).split())
