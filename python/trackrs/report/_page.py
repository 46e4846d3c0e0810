"""The page: a template with style and script, written once, and the sections of one report in it.

Everything a user names goes through `escape`, and what the script reads lies in one data block in which no `<` stands,
so that no text can end it. The page's own policy forbids every request and every script but its own.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
from html import escape
from pathlib import Path
from string import Template
from typing import IO, TYPE_CHECKING, Any

from trackrs._trackrs import __version__
from trackrs.errors import ParameterError
from trackrs.report._compare import comparison_html, number, wide
from trackrs.report._scene import packed, scene_data, track_rows
from trackrs.report.sections import Comparison, Curves, Picture, Prose, Scene, Section, Table, finite

if TYPE_CHECKING:
    from collections.abc import Sequence

HERE = Path(__file__).parent / "page"
SCRIPTS = ("data.js", "clock.js", "scene.js", "draw.js", "hands.js", "curves.js", "page.js")
TRACK_COLUMNS = ("track", "first (s)", "last (s)", "scans", "reports", "mean speed (m/s)", "status")
BADGES = {"holds": "good", "agrees": "good", "does not hold": "bad", "differs": "bad"}
FEW = 4  # titled sections from which on the page begins with a list of them
MANY = 12  # and from which on the list has only the first one and the texts, if there are titled ones


def write_report(
    path_or_file: str | Path | IO[str], title: str, sections: Sequence[Section], *, subtitle: str = ""
) -> None:
    """Write a report: one HTML file that needs neither a network nor anything beside it.

    Args:
        path_or_file: where it goes, usually *.html: all of it, or nothing; or a file open for text.
        title: of the page.
        sections: what it shows, in this order.
        subtitle: a line below the title.

    Raises:
        ParameterError: something is no section.
        TableError: the file cannot be written.

    Example:
        >>> import trackrs as tr
        >>> rows = [["OSPA below 10 m", 8.2, "holds"]]
        >>> table = tr.report.Table(["claim", "ours (m)", "verdict"], rows, verdict="verdict")
        >>> tr.report.write_report("out.html", "Claims", [table])  # doctest: +SKIP
    """
    page = _page(title, subtitle, sections)
    if not isinstance(path_or_file, str | Path):
        path_or_file.write(page)
        return
    from trackrs.io import replacing  # noqa: PLC0415 (not for those who only make a page)

    with replacing(Path(path_or_file)) as file:
        file.write_text(page, encoding="utf-8")


def _page(title: str, subtitle: str, sections: Sequence[Section]) -> str:
    data: dict[str, list[Any]] = {"scenes": [], "curves": []}
    body = [_section(k, section, data) for k, section in enumerate(sections)]
    titled = [(k, section.title) for k, section in enumerate(sections) if section.title]
    texts = [entry for entry in titled if isinstance(sections[entry[0]], Prose)]
    listed = titled
    if len(titled) > MANY and len(texts) > 1:
        listed = [entry for entry in titled if entry == titled[0] or entry in texts]
    links = "".join(f'<li><a href="#section-{k}">{escape(name)}</a></li>' for k, name in listed)
    style = _text("page.css")
    # The parts share one scope, and nothing but `window.report` is seen from outside.
    script = "(() => {\n'use strict';\n" + "\n".join(_text(name) for name in SCRIPTS) + "\n})();\n"
    return Template(_text("page.html")).substitute(
        title=escape(title),
        subtitle=f"<p>{escape(subtitle)}</p>" if subtitle else "",
        contents=f'<nav aria-label="Contents"><ol>{links}</ol></nav>' if len(titled) >= FEW else "",
        body="\n".join(body),
        data=_safe_json(data),
        style=style,
        script=script,
        style_hash=_hash(style),
        script_hash=_hash(script),
        version=escape(__version__),
    )


def _section(index: int, section: object, data: dict[str, list[Any]]) -> str:
    if not isinstance(section, Section):
        msg = f"sections[{index}] is a {type(section).__name__}, no section of a report"
        raise ParameterError(msg)
    heading = f"<h2>{escape(section.title)}</h2>" if section.title else ""
    kind = type(section).__name__.lower()
    return f'<section class="{kind}" id="section-{index}">{heading}{_body(section, data)}</section>'


def _body(section: Section, data: dict[str, list[Any]]) -> str:
    if isinstance(section, Scene):
        return _scene(section, data)
    if isinstance(section, Curves):
        return _curves(section, data)
    if isinstance(section, Comparison):
        return comparison_html(section)
    if isinstance(section, Table):
        return _table(section)
    if isinstance(section, Picture):
        assert isinstance(section.source, bytes)  # noqa: S101 (read when it was made)
        source = base64.b64encode(section.source).decode("ascii")
        return f'<img src="data:{section.kind};base64,{source}" alt="{escape(section.alt)}">'
    paragraphs = [part.strip() for part in section.text.split("\n\n")]
    return "".join(f"<p>{escape(part)}</p>" for part in paragraphs if part)


def _scene(scene: Scene, data: dict[str, list[Any]]) -> str:
    place = len(data["scenes"])
    data["scenes"].append(scene_data(scene))
    rows = track_rows(scene.tracks)
    cells = "".join(_track_row(k, row) for k, row in enumerate(rows))
    return Template(_text("scene.html")).substitute(
        place=place,
        name=escape(scene.title or "Tracks"),
        count=f"{len(rows)} track{'' if len(rows) == 1 else 's'}",
        table=_grid(TRACK_COLUMNS, cells, "Tracks"),
    )


def _track_row(place: int, row: Sequence[object]) -> str:
    name = escape(str(row[0]))
    button = f'<button type="button" aria-pressed="false" aria-label="Show track {name}">{name}</button>'
    return f'<tr data-track="{place}"><td>{button}</td>{"".join(_cell(value, digits=2) for value in row[1:])}</tr>'


def _curves(section: Curves, data: dict[str, list[Any]]) -> str:
    data["curves"].append(
        {
            "x": section.x,
            "y": section.y,
            "band": section.band,
            # The clock of the scene before it, or of the first.
            "scene": max(len(data["scenes"]) - 1, 0) if section.timed else None,
            "lines": [
                {
                    "name": line.name,
                    "x": packed(finite(line.x), "f64"),
                    "y": packed(finite(line.y), "f32"),
                    "low": None if line.low is None else packed(finite(line.low), "f32"),
                    "high": None if line.high is None else packed(finite(line.high), "f32"),
                }
                for line in section.lines
            ],
        }
    )
    names = ", ".join(line.name for line in section.lines)
    label = f"{section.y or section.title} over {section.x}: {names}"
    return f'<div class="plot" data-curves="{len(data["curves"]) - 1}" data-label="{escape(label)}"></div>'


def _table(table: Table) -> str:
    rows = "".join(
        "<tr>"
        + "".join(_cell(value, badge=name == table.verdict) for name, value in zip(table.columns, row, strict=True))
        + "</tr>"
        for row in table.rows
    )
    return _grid(table.columns, rows, table.title)


def _grid(columns: Sequence[str], rows: str, name: str) -> str:
    head = "".join(
        f'<th scope="col"><button type="button" class="sort">{escape(name)}</button></th>' for name in columns
    )
    return f"{wide(name)}<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>"


def _cell(value: object, *, badge: bool = False, digits: int | None = None) -> str:
    if badge and value not in {None, ""}:
        kind = BADGES.get(str(value), "")
        return f'<td><span class="badge {kind}">{escape(str(value))}</span></td>'
    if value is None:
        return "<td>–</td>"
    if isinstance(value, bool) or not hasattr(value, "__float__"):
        return f"<td>{escape(str(value))}</td>"
    figure = float(value)
    order = f' data-order="{figure!r}"' if math.isfinite(figure) else ""
    return f'<td class="number"{order}>{number(value, digits)}</td>'


def _text(name: str) -> str:
    return (HERE / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")


def _safe_json(data: object) -> str:
    """JSON that can stand in a script element: no `<` can end it or begin a comment."""
    text = json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
