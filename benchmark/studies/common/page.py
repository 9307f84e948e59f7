"""Rendering a study's page from its template."""

from __future__ import annotations

import jinja2


def render_page(template: str, **values: object) -> str:
    """Render a page of `benchmark/templates`: one HTML file that needs nothing beside it; everything is escaped."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("benchmark", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(**values)
