# SPDX-License-Identifier: GPL-3.0-or-later
"""Puts what a part has measured between its markers on a page of the documentation."""

from pathlib import Path

from btfsep_engine.atomic import write_text


def markers(part: str) -> tuple[str, str]:
    """The lines before and after what scripts/bench_transport writes for a part."""
    return f"<!-- bench_transport {part} -->", f"<!-- end of {part} -->"


def replaced(page: str, part: str, text: str) -> str:
    """The page with ``text`` between the part's markers.

    Raises
    ------
    ValueError
        Where the page lacks a marker, or has one twice.
    """
    before, after = markers(part)
    if page.count(before) != 1 or page.count(after) != 1 or page.index(before) > page.index(after):
        raise ValueError(f"the page needs the lines {before} and {after}, once each, in this order")
    head, tail = page[: page.index(before) + len(before)], page[page.index(after) :]
    return f"{head}\n\n{text.strip()}\n\n{tail}"


def write(path: Path, part: str, text: str) -> None:
    """Writes the part's text into the page at ``path``."""
    write_text(path, replaced(path.read_text(encoding="utf-8"), part, text))
