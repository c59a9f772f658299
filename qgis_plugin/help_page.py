"""The help page of the plugin, from docs/qgis.md: that of the site, without a network."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html import escape
from pathlib import Path

PAGE = Path(__file__).resolve().parents[1] / "docs" / "qgis.md"
STYLE = """
body { font: 16px/1.5 sans-serif; max-width: 50em; margin: 2em auto; padding: 0 1em; color: #222; }
table { border-collapse: collapse; } td, th { border: 1px solid #ccc; padding: .3em .6em; text-align: left; }
img { max-width: 100%; border: 1px solid #ccc; } tr:target { background: #fff3bf; }
code, pre { background: #f3f3f3; } pre { padding: .6em; overflow-x: auto; }
"""
INLINE = re.compile(r"`([^`]+)`|!\[([^\]]*)\]\(([^)]+)\)|\[([^\]]+)\]\(([^)]+)\)|\*\*([^*]+)\*\*|\*([^*]+)\*")
ITEM = re.compile(r"(\d+\.|-) +(.*)", re.DOTALL)


def page(markdown: str, site: str) -> tuple[str, list[str]]:
    """Return the page as HTML, and the paths of its pictures, which lie beside it under their own names.

    Parameters
    ----------
    markdown : str
        Of the documentation: headings, paragraphs, lists, tables with pipes, fenced code, one line a row.
    site : str
        Address of the documentation, for links to its other pages.
    """
    pictures = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", markdown)
    body = "\n".join(_block(block, site) for block in _blocks(markdown))
    head = f'<meta charset="utf-8"><title>pcwlad-geo</title><style>{STYLE}</style>'
    return f"<!DOCTYPE html>\n<html><head>{head}</head><body>\n{body}\n</body></html>\n", pictures


def slug(text: str) -> str:
    """Return the anchor of a heading or a row."""
    return re.sub(r"\W+", "-", text.lower()).strip("-")


def _blocks(text: str) -> Iterator[str]:
    """Yield what blank lines part; fenced code and what belongs to an item of a list stay whole."""
    found = ""
    for part in re.split(r"\n{2,}", text.strip()):
        inside = found.count("```") % 2 or (
            ITEM.match(found) and (ITEM.match(part) or part.startswith("    "))
        )
        if found and not inside:
            yield found
            found = part
        else:
            found = f"{found}\n\n{part}" if found else part
    yield found


def _block(block: str, site: str) -> str:
    if heading := re.match(r"(#+) (.*)", block):
        level = len(heading[1])
        return f'<h{level} id="{slug(heading[2])}">{_inline(heading[2], site)}</h{level}>'
    if block.startswith("```"):
        return f"<pre>{escape(block.split(chr(10), 1)[1].rsplit('```', 1)[0])}</pre>"
    if block.startswith("|"):
        return _table(block.splitlines(), site)
    if first := ITEM.match(block):
        tag = "ol" if first[1][0].isdigit() else "ul"
        items = re.split(r"\n+(?=(?:\d+\.|-) )", block)
        return f"<{tag}>\n" + "".join(_item(item, site) for item in items) + f"</{tag}>"
    return f"<p>{_inline(block, site)}</p>"


def _item(item: str, site: str) -> str:
    text = re.sub(r"\n {2,4}", "\n", ITEM.sub(r"\2", item))
    return "<li>" + "".join(_block(block, site) for block in _blocks(text)) + "</li>\n"


def _table(lines: list[str], site: str) -> str:
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in (lines[0], *lines[2:])]
    html = ["<tr>" + "".join(f"<th>{_inline(cell, site)}</th>" for cell in rows[0]) + "</tr>"]
    for first, *more in rows[1:]:
        cells = "".join(f"<td>{_inline(cell, site)}</td>" for cell in (first, *more))
        html.append(f'<tr id="{slug(first)}">{cells}</tr>')
    return "<table>\n" + "\n".join(html) + "\n</table>"


def _inline(text: str, site: str) -> str:
    """Return a text with its code, pictures, links and emphasis."""
    parts, last = [], 0
    for found in INLINE.finditer(text):
        parts += [escape(text[last : found.start()]), _marked(found, site)]
        last = found.end()
    return "".join([*parts, escape(text[last:])])


def _marked(found: re.Match[str], site: str) -> str:
    code, alternative, picture, label, target, bold, italic = found.groups()
    if code:
        return f"<code>{escape(code)}</code>"
    if picture:
        return f'<img src="{escape(Path(picture).name)}" alt="{escape(alternative)}">'
    if label:
        return _link(_inline(label, site), target, site)
    tag, inner = ("b", bold) if bold else ("i", italic)
    return f"<{tag}>{_inline(inner, site)}</{tag}>"


def _link(label: str, target: str, site: str) -> str:
    """Return a link; other pages are those of the site, where it has an address."""
    if not target.startswith(("#", "https://")):
        if ".invalid" in site:
            return label
        target = site + target.replace(".md", "/")
    return f'<a href="{escape(target)}">{label}</a>'
