"""Tables as Markdown and as LaTeX: the one writer of every table in the documents and of `loco-mjx table`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_ESCAPED = {"&": r"\&", "%": r"\%", "_": r"\_", "#": r"\#"}
_SYMBOLS = {" ± ": r" $\pm$ ", "↑": r"$\uparrow$", "↓": r"$\downarrow$", "→": r"$\to$", "×": r"$\times$"}
_SYMBOLS |= {"–": "--", "—": "---"}


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def latex(
    caption: str, columns: str, head: Sequence[str], rows: Sequence[Sequence[str]], above: Sequence[str] = ()
) -> str:
    """A table in LaTeX, for the package booktabs.

    Args:
        caption: of it, in LaTeX.
        columns: their alignment: `lrr`.
        head: of the columns, plain text.
        rows: of cells, plain text.
        above: cells of a line above the head, in LaTeX.
    """
    lines = ["\\begin{table}", "\\centering\\small", f"\\caption{{{caption}.}}", f"\\begin{{tabular}}{{{columns}}}"]
    lines += ["\\toprule", *([_line(above)] if above else []), _line([tex(cell) for cell in head]), "\\midrule"]
    lines += [_line([tex(cell) for cell in row]) for row in rows]
    return "\n".join([*lines, "\\bottomrule", "\\end{tabular}", "\\end{table}"])


def tex(text: str) -> str:
    """Plain text in LaTeX."""
    for plain, escaped in (_ESCAPED | _SYMBOLS).items():
        text = text.replace(plain, escaped)
    return text


def mean_and_std(values: Sequence[float], digits: int) -> str:
    """Mean ± standard deviation (the population's) over seeds; of one seed the mean."""
    mean = f"{np.mean(values):.{digits}f}"
    return f"{mean} ± {np.std(values):.{digits}f}" if len(values) > 1 else mean


def _line(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"
