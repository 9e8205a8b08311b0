"""What mkdocs asks of us: a link to a file of the repository that is no page becomes plain text."""

import re
from typing import Any

LINK = re.compile(r"(?<!!)\[([^]]+)\]\(((?!https?:)[^)#\s]+)(?:#[^)]*)?\)")


def on_page_markdown(markdown: str, page: Any, files: Any, **_: object) -> str:  # noqa: ANN401
    """Return the page's text without links that leave the documentation."""

    def plain(found: re.Match[str]) -> str:
        target = page.file.src_uri.rpartition("/")[0].split("/") if "/" in page.file.src_uri else []
        for part in found[2].split("/"):
            if part != "..":
                target = [*target, part]
            elif not target:
                return found[1]  # above docs/
            else:
                target = target[:-1]
        return found[1] if found[2].endswith("/") else found[0]

    return LINK.sub(plain, markdown)
