"""The paper's tables filled with our figures beside the paper's, and what is missing of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from loco_mjx.compare import paper
from loco_mjx.compare.methods import Method, methods
from loco_mjx.compare.paper import Column, PaperTable, Row, Value
from loco_mjx.errors import UserError
from loco_mjx.run import results
from loco_mjx.run.results import Evaluation, OverSeeds, Run


@dataclass(frozen=True)
class FilledCell:
    """One figure.

    Attributes:
        paper: its mean and standard deviation; None where the paper has a dash.
        ours: over seeds; None where nothing was evaluated.
        evaluations: that ours stands on.
    """

    paper: Value | None
    ours: OverSeeds | None = None
    evaluations: tuple[Evaluation, ...] = ()


@dataclass(frozen=True)
class FilledTable:
    """A table of the paper with our figures.

    Attributes:
        table: of the paper, without the columns of which nothing was evaluated.
        cells: one tuple per row.
        notes: what is missing or was left out, a sentence each.
    """

    table: PaperTable
    cells: tuple[tuple[FilledCell, ...], ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Findings:
    """What a directory holds.

    Attributes:
        methods: what was measured of each.
        tables: those of the paper of which something was evaluated.
        empty: the others.
        notes: about the whole directory.
    """

    methods: tuple[Method, ...]
    tables: tuple[FilledTable, ...]
    empty: tuple[PaperTable, ...]
    notes: tuple[str, ...]


@dataclass
class _Notes:
    lines: dict[str, None] = field(default_factory=dict)

    def add(self, text: str) -> None:
        self.lines.setdefault(text)


def fill(folder: Path, mixed_versions: bool = False) -> Findings:
    """Fills every table from the runs in a directory.

    Args:
        folder: of the runs.
        mixed_versions: accept evaluations made by different versions.

    Raises:
        UserError: if there is nothing to compare, or what there is cannot be compared.
    """
    runs = results.find_runs(folder)
    evaluations = results.find_evaluations(runs)
    if not evaluations:
        raise UserError(
            f"{_count(len(runs), 'run')} in {folder}, none evaluated; let `loco-mjx sweep` finish, or use "
            "`loco-mjx evaluate`"
        )
    if not mixed_versions:
        versions = [(one.path, one.versions) for one in evaluations]
        results.check_versions(versions, "evaluate the runs again with one version")
    measured = methods(evaluations)
    tables = {table: _fill_table(table, runs, evaluations) for table in paper.TABLES}
    return Findings(
        measured,
        tuple(filled for filled in tables.values() if filled.table.columns),
        tuple(table for table, filled in tables.items() if not filled.table.columns),
        tuple(_overall(runs, evaluations)),
    )


def _fill_table(table: PaperTable, runs: Sequence[Run], evaluations: Sequence[Evaluation]) -> FilledTable:
    """The table without the columns of which nothing was evaluated."""
    evaluated = {(one.run.config.env.task, one.task) for one in evaluations if _has_place(one.run, table)}
    kept = [i for i, column in enumerate(table.columns) if (column.trained_on, column.evaluated_on) in evaluated]
    rows = tuple(replace(row, values=tuple(row.values[i] for i in kept)) for row in table.rows)
    shorter = replace(table, columns=tuple(table.columns[i] for i in kept), rows=rows)
    notes = _Notes()
    for column in table.columns:
        if column not in shorter.columns:
            notes.add(f"left out: {column.title}: nothing evaluated")
    cells = tuple(
        tuple(
            _fill_cell(row, column, value, runs, evaluations, notes)
            for column, value in zip(shorter.columns, row.values, strict=True)
        )
        for row in rows
    )
    return FilledTable(shorter, cells, tuple(notes.lines))


def _has_place(run: Run, table: PaperTable) -> bool:
    """Whether a run is of one of the table's methods."""
    return any(row.variant.matches(run.flat) for row in table.rows)


def _fill_cell(
    row: Row,
    column: Column,
    value: Value | None,
    runs: Sequence[Run],
    evaluations: Sequence[Evaluation],
    notes: _Notes,
) -> FilledCell:
    own = [run for run in runs if run.config.env.task == column.trained_on and row.variant.matches(run.flat)]
    found = [one for one in evaluations if one.run in own and one.task == column.evaluated_on]
    what = f"{row.label} trained on {column.trained_on}"
    if not found:
        why = "no run" if not own else f"{_count(len(own), 'run')}, none evaluated on {column.evaluated_on}"
        notes.add(f"missing: {what}: {why}")
        return FilledCell(value)
    most = max(one.samples for one in found)
    used = [one for one in found if one.samples == most]
    for one in found:
        if one not in used:
            notes.add(f"left out: {what}, seed {one.run.config.seed}: {one.samples:,} samples, others {most:,}")
    for run in own:
        if run not in [one.run for one in found]:
            notes.add(f"missing: {what}, seed {run.config.seed}: not evaluated on {column.evaluated_on}")
    results.check_same_method([one.run for one in used], what)
    missing = next((one for one in used if column.metric not in one.metrics), None)
    if missing is not None:
        raise UserError(f"{missing.path} has no '{column.metric}'; evaluate the run again")
    ours = results.over_seeds([one.metrics[column.metric] for one in used])
    return FilledCell(value, ours, tuple(used))


def _overall(runs: Sequence[Run], evaluations: Sequence[Evaluation]) -> list[str]:
    """Runs that are not finished, and those that no table of the paper has a place for."""
    notes = []
    for run in runs:
        newest = max((one.samples for one in evaluations if one.run is run), default=0)
        if newest < run.samples:
            how = f"evaluated at {newest:,} of its {run.samples:,} samples" if newest else "not evaluated"
            notes.append(f"unfinished: {run.path}: {how}")
    for run in runs:
        tables = [table for table in paper.TABLES if run.config.env.task in {c.trained_on for c in table.columns}]
        if not any(_has_place(run, table) for table in tables):
            label = results.variant_of(run.flat).label
            notes.append(f"in no table of the paper: {run.path} ({label} on {run.config.env.task})")
    return notes


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")
