"""The single way to render pages: Jinja templates and style sheets of `benchmark/templates`, with everything escaped."""

from __future__ import annotations

from importlib import resources

import jinja2
from markupsafe import Markup

from generator.drawing.palette import palette_sheet

PAGES = "benchmark"
"""Package whose folder ``templates`` holds the pages."""


def environment(**shared: object) -> jinja2.Environment:
    """Environment of the templates; values are escaped, and a name without a value is an error.

    Parameters
    ----------
    **shared : object
        Values and functions visible in all pages rendered with it, including imported macros, in addition to ``palette``: the
        style sheet with the colours of the project.
    """
    made = jinja2.Environment(
        loader=jinja2.PackageLoader(PAGES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals.update(shared, palette=Markup(palette_sheet()))
    return made


def render_page(template: str, **values: object) -> str:
    """Render a page of ``benchmark/templates``: one HTML file.

    Parameters
    ----------
    template : str
        Name of the file, from the folder of templates.
    **values : object
        Values that the template names; text is escaped, `markupsafe.Markup` is not.

    Raises
    ------
    jinja2.UndefinedError
        The template names a value that is missing.
    """
    return environment().get_template(template).render(**values)


def read_sheet(name: str) -> str:
    """Read a style sheet or script from the folder of templates, without changes."""
    return resources.files(PAGES).joinpath("templates", *name.split("/")).read_text(encoding="utf-8")
