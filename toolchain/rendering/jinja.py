"""The one jinja2 environment of the code generators: an unknown name is an error, never empty text."""

from __future__ import annotations

from functools import cache

import jinja2


@cache
def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.PackageLoader("neuroflight.toolchain.rendering"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )


def render(template: str, **values: object) -> str:
    """Render `templates/<template>` with `values`. Raises jinja2.UndefinedError for an unknown name."""
    return _environment().get_template(template).render(**values)
