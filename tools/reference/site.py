"""A hook of mkdocs: the site holds docs/ and the records outside it; links work there as they do in the repository.

A link from docs/ to studies/ leaves the folder that mkdocs knows, so the records are added below it and links are set right;
links to other files of the repository (code, configuration) become plain text.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
#: Folders with records, and what of them is shown.
RECORDS = ("studies/", "tests/robustness/")
SHOWN = (".md", ".png", ".svg")

_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s#]+)(#[^)\s]*)?\)")


def on_files(files: Files, /, *, config: MkDocsConfig) -> Files:
    """Adds the records' pages and pictures."""
    for path in sorted(path for folder in RECORDS for path in (ROOT / folder).rglob("*")):
        if path.suffix in SHOWN:
            files.append(File.generated(config, path.relative_to(ROOT).as_posix(), abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, /, *, page: Any, files: Files, **_: Any) -> str:
    """Sets links right that leave the page's own tree."""
    here = page.file.src_uri
    in_repository = here if here.startswith(RECORDS) else f"docs/{here}"

    def rewritten(match: re.Match[str]) -> str:
        picture, text, target, anchor = match[1], match[2], match[3], match[4] or ""
        if "://" in target or target.startswith(("mailto:", "/")):
            return match[0]
        wanted = posixpath.normpath(posixpath.join(posixpath.dirname(in_repository), target))
        inside = wanted.removeprefix("docs/") if wanted.startswith("docs/") else wanted
        if wanted.startswith(("docs/", *RECORDS)) and files.get_file_from_path(inside):
            return f"{picture}[{text}]({posixpath.relpath(inside, posixpath.dirname(here) or '.')}{anchor})"
        # A missing page stays a link, about which mkdocs then complains; what is there but not in the site is only named.
        return text if (ROOT / wanted).exists() else match[0]

    return _LINK.sub(rewritten, markdown)
