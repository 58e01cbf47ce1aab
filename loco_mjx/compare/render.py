"""What a directory holds, as Markdown and as LaTeX: a summary, each task's evaluations, the paper's tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from loco_mjx.compare import markup, methods
from loco_mjx.compare.methods import Method
from loco_mjx.compare.paper import Column, Value
from loco_mjx.compare.tables import FilledCell, FilledTable, Findings
from loco_mjx.evaluation.display import DISTANCE, LEADING, NOTHING
from loco_mjx.run.results import Evaluation

EXPLANATION = (
    "Mean ± standard deviation over seeds of each seed's mean over episodes, acting by the policy's mean, without "
    "randomisation; with one seed there is no deviation to give. In the paper's tables its figure stands beside that "
    "of loco-mjx; both deviations are the population's. Samples, seeds and episodes of each evaluation are those that "
    "the figures of loco-mjx stand on. The first 16 s are what 1,000 steps of the authors' code last."
)
OURS, THEIRS = "loco-mjx", "paper"


@dataclass(frozen=True)
class Block:
    """A table of text.

    Attributes:
        title: of it.
        head: of its columns.
        rows: of words, as many as the head has.
    """

    title: str
    head: list[str]
    rows: list[list[str]]


def markdown(findings: Findings) -> str:
    """Everything as Markdown."""
    first, *others = blocks(findings.methods)
    parts = [
        "# Results\n",
        f"## {first.title}\n\n{markup.markdown(first.head, first.rows)}",
        EXPLANATION + "\n",
        "## By task\n",
    ]
    parts += [f"### {block.title}\n\n{markup.markdown(block.head, block.rows)}" for block in others]
    parts += ["## The paper's tables\n", *(_markdown_table(filled) for filled in findings.tables)]
    if findings.empty:
        parts.append(f"{_left_out(findings)}.\n")
    if findings.notes:
        parts.append("## Runs\n\n" + _bullets(findings.notes))
    return "\n".join(parts)


def latex(findings: Findings) -> str:
    """Everything as LaTeX; it needs the package booktabs."""
    parts = [f"% {EXPLANATION}", "% Needs \\usepackage{booktabs}.", ""]
    parts += [_latex_block(block) for block in blocks(findings.methods)]
    parts += [_latex_table(filled) for filled in findings.tables]
    parts += [f"% {_left_out(findings)}"] if findings.empty else []
    parts += [f"% {note}" for note in findings.notes]
    return "\n".join(parts) + "\n"


def blocks(found: Sequence[Method]) -> list[Block]:
    """The summary, policy × task with one metric; then all metrics, a table for each task."""
    places = methods.places(found)
    at = {(one.label, one.where): one for one in found}
    figures = {key: one.figure(DISTANCE) for key, one in at.items()}
    rows = [[label, *(figures.get((label, place), NOTHING) for place in places)] for label in methods.labels(found)]
    summary = Block(f"Summary: {DISTANCE.label} ({DISTANCE.unit})", ["policy", *places], rows)
    each = [
        Block(place, ["policy", *methods.heads()], [_method(one) for one in found if one.where == place])
        for place in places
    ]
    return [summary, *each]


def _method(one: Method) -> list[str]:
    return [one.label, *(one.figure(shown) for shown in LEADING), *methods.basis(one)]


def _left_out(findings: Findings) -> str:
    names = [f"{table.number} ({table.title})" for table in findings.empty]
    return f"Left out, since nothing of them has been evaluated: tables of the paper {', '.join(names)}"


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
        head += [f"{column.title} {_arrow(column)}: {OURS}", THEIRS]
    body = markup.markdown([*head, "samples", "seeds", "episodes"], _rows(filled))
    notes = "\n" + _bullets(filled.notes) if filled.notes else ""
    return f"### Table {filled.table.number}. {filled.table.title}\n\n{body}{notes}"


def _rows(filled: FilledTable) -> list[list[str]]:
    return [
        [row.label, *(word for cell in cells for word in (ours(cell), printed(cell.paper))), *_basis_words(cells)]
        for row, cells in zip(filled.table.rows, filled.cells, strict=True)
    ]


def _bullets(notes: Sequence[str]) -> str:
    return "".join(f"- {note}\n" for note in notes)


def _latex_table(filled: FilledTable) -> str:
    columns = filled.table.columns
    groups = [f"\\multicolumn{{2}}{{c}}{{{markup.tex(c.title)} {markup.tex(_arrow(c))}}}" for c in columns]
    head = ["Method", *([OURS, THEIRS] * len(columns)), "samples", "seeds", "episodes"]
    caption = f"{markup.tex(filled.table.title)} (the paper's \\texttt{{{filled.table.source}}})"
    text = markup.latex(caption, f"l{'rr' * len(columns)}rrr", head, _rows(filled), ["", *groups, "", "", ""])
    return "\n".join([text, *(f"% {note}" for note in filled.notes), ""])


def _latex_block(block: Block) -> str:
    return markup.latex(markup.tex(block.title), "l" + "r" * (len(block.head) - 1), block.head, block.rows) + "\n"
