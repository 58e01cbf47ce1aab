"""The filled tables as Markdown and as LaTeX."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from loco_mjx.compare.paper import Column, Value
from loco_mjx.compare.results import Evaluation
from loco_mjx.compare.tables import FilledCell, FilledTable, Findings

EXPLANATION = (
    "Ours: mean ± standard deviation over seeds of each seed's mean over episodes, acting by the policy's mean, "
    "without randomisation; with one seed there is no deviation to give. Beside it the paper's figure. Both deviations "
    "are the population's. Samples, seeds and episodes of each evaluation are those that ours stand on."
)
NOTHING = "–"
_ESCAPED = {"&": r"\&", "%": r"\%", "_": r"\_", "#": r"\#"}


def markdown(findings: Findings) -> str:
    """Every table as Markdown."""
    parts = ["# The paper's tables, ours beside the paper's\n", EXPLANATION + "\n"]
    parts += [_markdown_table(filled) for filled in findings.tables]
    if findings.notes:
        parts.append("## Runs\n\n" + _bullets(findings.notes))
    return "\n".join(parts)


def latex(findings: Findings) -> str:
    """Every table as LaTeX; it needs the package booktabs."""
    parts = [f"% {EXPLANATION}", "% Needs \\usepackage{booktabs}.", ""]
    parts += [_latex_table(filled) for filled in findings.tables]
    parts += [f"% {note}" for note in findings.notes]
    return "\n".join(parts) + "\n"


def ours(cell: FilledCell) -> str:
    """Our figure in words."""
    if cell.ours is None:
        return NOTHING
    mean, std = cell.ours.mean, cell.ours.std
    return _pair((mean, std)) if len(cell.ours.values) > 1 else _number(mean)


def printed(value: Value | None) -> str:
    """The paper's figure in words."""
    return NOTHING if value is None else _pair(value)


def basis(row: Sequence[FilledCell], figure: Callable[[Sequence[Evaluation]], Sequence[int]]) -> str:
    """The smallest and largest of something over what a row stands on."""
    found = [value for cell in row if cell.evaluations for value in figure(cell.evaluations)]
    if not found:
        return NOTHING
    low, high = min(found), max(found)
    return f"{low:,}" if low == high else f"{low:,}–{high:,}"


def _basis_words(row: Sequence[FilledCell]) -> list[str]:
    return [
        basis(row, lambda found: [one.samples for one in found]),
        basis(row, lambda found: [len(found)]),
        basis(row, lambda found: [one.episodes for one in found]),
    ]


def _pair(value: Value) -> str:
    return f"{_number(value[0])} ± {_number(value[1])}"


def _number(value: float) -> str:
    """One decimal, as the paper has it; what rounds to nothing has no sign."""
    return f"{round(value, 1) + 0.0:.1f}"


def _arrow(column: Column) -> str:
    return "↑" if column.higher else "↓"


def _markdown_table(filled: FilledTable) -> str:
    head = ["method"]
    for column in filled.table.columns:
        head += [f"{column.title} {_arrow(column)}: ours", "paper"]
    head += ["samples", "seeds", "episodes"]
    lines = [head, ["---"] * len(head)]
    for row, cells in zip(filled.table.rows, filled.cells, strict=True):
        figures = [word for cell in cells for word in (ours(cell), printed(cell.paper))]
        lines.append([row.label, *figures, *_basis_words(cells)])
    body = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    notes = "\n" + _bullets(filled.notes) if filled.notes else ""
    return f"## Table {filled.table.number}. {filled.table.title}\n\n{body}\n{notes}"


def _bullets(notes: Sequence[str]) -> str:
    return "".join(f"- {note}\n" for note in notes)


def _latex_table(filled: FilledTable) -> str:
    columns = filled.table.columns
    groups = [f"\\multicolumn{{2}}{{c}}{{{_tex(c.title)} {_tex(_arrow(c))}}}" for c in columns]
    lines = [
        "\\begin{table}",
        "\\centering\\small",
        f"\\caption{{{_tex(filled.table.title)} (the paper's \\texttt{{{filled.table.source}}}).}}",
        f"\\begin{{tabular}}{{l{'rr' * len(columns)}rrr}}",
        "\\toprule",
        _line(["", *groups, "", "", ""]),
        _line(["Method", *(["ours", "paper"] * len(columns)), "samples", "seeds", "episodes"]),
        "\\midrule",
    ]
    for row, cells in zip(filled.table.rows, filled.cells, strict=True):
        figures = [word for cell in cells for word in (ours(cell), printed(cell.paper))]
        lines.append(_line([_tex(word) for word in (row.label, *figures, *_basis_words(cells))]))
    lines += ["\\bottomrule", "\\end{tabular}", "\\end{table}", *(f"% {note}" for note in filled.notes), ""]
    return "\n".join(lines)


def _line(words: Sequence[Any]) -> str:
    return " & ".join(words) + r" \\"


def _tex(text: str) -> str:
    for plain, escaped in _ESCAPED.items():
        text = text.replace(plain, escaped)
    symbols = {" ± ": r" $\pm$ ", "↑": r"$\uparrow$", "↓": r"$\downarrow$", "×": r"$\times$", "–": "--"}
    for plain, escaped in symbols.items():
        text = text.replace(plain, escaped)
    return text
