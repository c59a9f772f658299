"""What hatchling calls as it builds: the README for the package index, whose links lead to the repository.

There the README stands alone: a link to ``docs/stack.md`` or a picture beside it would lead nowhere. They get
the address of the project, and the tag of the version that is built.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\[\]]*\])*)\]\((?![a-z]+:|#)([^)\s]+)\)")
"""A link, or a picture, whose target is a file of the repository."""


class IndexReadme(MetadataHookInterface):
    """Gives the README to the metadata of what is built."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Add the README."""
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        address, version = metadata["urls"]["Repository"], metadata["version"]
        metadata["readme"] = {"content-type": "text/markdown", "text": with_addresses(text, address, version)}


def with_addresses(text: str, repository: str, version: str) -> str:
    """Return Markdown in which what lies in the repository has its address there."""

    def addressed(link: re.Match[str]) -> str:
        picture, label, path = link.groups()
        return f"{picture}[{label}]({repository}/{'raw' if picture else 'blob'}/v{version}/{path})"

    return LINK.sub(addressed, text)
