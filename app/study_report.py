"""A study's record to read: the words of its table, and the table as Markdown or as one HTML file with its figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

Record = Mapping[str, Any]
NAMED = ("wattlane", "python", "numpy", "numba")
"""Versions that are named with a result; the JSON has all of them."""
HEAD = ("experiment", "quantity", "case", "paper", "ours", "95 %", "n", "verdict")


def number(value: float | None, unit: str = "") -> str:
    """A mean with two decimals; a dash when there is none."""
    return "–" if value is None else f"{value:.2f}"


def paper_words(row: Record) -> str:
    """What the paper prints: a value, a range, or nothing."""
    if row["paper"] is None:
        return "–"
    low, high = row["paper"]
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


def interval_words(row: Record) -> str:
    return "–" if row["half_width"] is None else f"±{row['half_width']:.2f}"


def verdict_words(row: Record) -> str:
    """`inside`, `outside by +1.20`, `inside, mean +0.04` where only the interval meets the paper; else a dash."""
    if not row["off"]:
        return str(row["verdict"])
    return f"{row['verdict']}{', mean' if row['verdict'] == 'inside' else ' by'} {row['off']:+.2f}".replace("-", "−")


def cells_of(row: Record) -> list[str]:
    """A row of the table in words, as HEAD names them."""
    note = f" ({row['note']})" if row.get("note") else ""
    return [
        str(row["experiment"]),
        f"{row['quantity']}{note}" + (f", {row['unit']}" if row["unit"] else ""),
        str(row["case"]),
        paper_words(row),
        number(row["ours"]),
        interval_words(row),
        str(row["n"]),
        verdict_words(row),
    ]


def tally(record: Record) -> str:
    """How many rows that the paper prints lie inside."""
    printed = [row for row in record["rows"] if row["paper"] is not None]
    inside = sum(row["verdict"] == "inside" for row in printed)
    return f"{inside} of {len(printed)} rows that the paper prints lie inside"


def judged(record: Record) -> str:
    """What the judge says."""
    found = record["breaches"]
    word = "no breach" if not found else f"{found} breach{'es' if found > 1 else ''}"
    return f"{word} in {record['plans']:,} plans judged"


def counted_words(made: Record) -> str:
    """`100 maps`, `5 seeds`."""
    return f"{made['maps']} {made.get('counted', 'maps')}"


def made_words(record: Record) -> str:
    """When the result was made, and how."""
    made = record["made"]
    kind = "Quick run" if made["quick"] else "Run"
    versions = ", ".join(f"{name} {made['versions'][name]}" for name in NAMED if name in made["versions"])
    return f"{kind} of {counted_words(made)} per case, seed {made['seed']}, {made['at'][:10]}; {versions}"


def value_words(value: Any) -> str:
    """A parameter's value."""
    if isinstance(value, list):
        return ", ".join(value_words(item) for item in value)
    return f"{value:.10g}" if isinstance(value, float) else str(value)


# -- Markdown ---------------------------------------------------------------------------------------------------------


def markdown(record: Record) -> str:
    """Table, why ours differs, the parameter set."""
    lines = [f"# {record['title']}", "", f"{record['paper']}. {made_words(record)}.", ""]
    lines += [f"{number}. {what}" for number, what in record["experiments"].items()]
    lines += ["", f"{tally(record)}; {judged(record)}.", ""]
    lines += _markdown_table(HEAD, [cells_of(row) for row in record["rows"]])
    lines += ["", "## Why ours differs, and how it was counted", "", *[f"- {note}" for note in record["notes"]]]
    lines += ["", "## One parameter set for all rows", ""]
    lines += [f"- {name}: {value_words(value)}" for name, value in record["parameters"].items()]
    for figure in record["figures"]:
        if figure["kind"] == "table":
            data = figure["data"]
            lines += ["", f"## {figure['title']}", "", *_markdown_table(data["columns"], data["rows"])]
            lines += ["", data["note"]] if data.get("note") else []
    return "\n".join(lines) + "\n"


def _markdown_table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> list[str]:
    cells = [[value_words(cell).replace("|", "\\|") for cell in row] for row in rows]
    return [f"| {' | '.join(head)} |", "|" + "---|" * len(head), *[f"| {' | '.join(row)} |" for row in cells]]


# -- HTML -------------------------------------------------------------------------------------------------------------

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #17202b; background: #fff; max-width: 1100px; margin: 24px auto;
  padding: 0 16px; }
table { border-collapse: collapse; font-size: 14px; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: 4px 10px; border-bottom: 1px solid #d5dbe3; }
figure { margin: 24px 0; } figcaption { font-weight: 600; }
.panels { display: flex; flex-wrap: wrap; gap: 16px; } .panel { width: 340px; } .wide { width: 100%; height: 380px; }
.inside { color: #1c7d3c; font-weight: 600; } .outside { color: #b3261e; font-weight: 600; }
"""


def html(record: Record) -> str:
    """One file with everything in it, the code that draws the figures included: it needs no network."""
    import plotly.io
    from plotly.offline import get_plotlyjs

    from app.figures.study import study_panels

    parts = [f"<h1>{escape(record['title'])}</h1>", f"<p>{escape(record['paper'])}. {escape(made_words(record))}.</p>"]
    parts += ["<ol>", *[f"<li>{escape(what)}</li>" for what in record["experiments"].values()], "</ol>"]
    parts.append(f"<p>{escape(tally(record))}; {escape(judged(record))}.</p>")
    marked = [row["verdict"] for row in record["rows"]]
    parts.append(_html_table(HEAD, [cells_of(row) for row in record["rows"]], marked))
    for figure in record["figures"]:
        data = figure["data"]
        parts.append(f"<figure><figcaption>{escape(figure['title'])}</figcaption>")
        if figure["kind"] == "table":
            parts.append(_html_table(data["columns"], data["rows"], []))
        parts.append('<div class="panels">')
        for panel in study_panels(figure):
            kind = "wide" if panel.ratio is None else "panel"
            panel.chart.update_layout(height=380 if panel.ratio is None else int(60 + 340 * panel.ratio))
            drawn = plotly.io.to_html(panel.chart, full_html=False, include_plotlyjs=False, config={"responsive": True})
            parts.append(f'<div class="{kind}">{escape(panel.caption)}{drawn}</div>')
        parts.append(f"</div><p>{escape(data.get('note', ''))}</p></figure>")
    parts += ["<h2>Why ours differs, and how it was counted</h2><ul>"]
    parts += [f"<li>{escape(note)}</li>" for note in record["notes"]]
    parts += ["</ul><h2>One parameter set for all rows</h2>"]
    parts.append(_html_table(("parameter", "value"), list(record["parameters"].items()), []))
    head = f'<meta charset="utf-8"><title>{escape(record["title"])}</title><style>{STYLE}</style>'
    head += f"<script>{get_plotlyjs()}</script>"
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{"".join(parts)}</body></html>\n'


def _html_table(head: Sequence[str], rows: Sequence[Sequence[Any]], marks: Sequence[str]) -> str:
    lines = ["<table><thead><tr>", *[f"<th>{escape(word)}</th>" for word in head], "</tr></thead><tbody>"]
    for k, row in enumerate(rows):
        last = f' class="{escape(marks[k])}"' if k < len(marks) else ""
        cells = [escape(value_words(cell)) for cell in row]
        lines.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells[:-1]) + f"<td{last}>{cells[-1]}</td></tr>")
    return "".join([*lines, "</tbody></table>"])


def write_files(record: Record, folder: Path) -> list[Path]:
    """`<study>.json`, `.md` and `.html` in a folder, which is made."""
    from app.study import write_record

    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{record['study']}.{ending}" for ending in ("json", "md", "html")]
    write_record(dict(record), files[0])
    files[1].write_text(markdown(record), "utf-8")
    files[2].write_text(html(record), "utf-8")
    return files
