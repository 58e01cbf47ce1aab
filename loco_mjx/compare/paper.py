"""The numbers of the LocoTransformer paper (ICLR 2022), as data: its tables 1 to 5 and what each of their cells means.

The paper's "±" is the population's standard deviation: its 33.3 ± 47.1 of sphere reward is that of 0, 0 and 100.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from loco_mjx.run.variant import Variant

Value = tuple[float, float]  # mean and standard deviation
DISTANCE, COLLISIONS, SPHERES, RETURN = "distance", "collisions", "reward/sphere", "return"


@dataclass(frozen=True)
class Column:
    """One column of a table: a metric of policies trained on one task and evaluated on the same or another.

    Attributes:
        title: the paper's.
        metric: our name of it.
        trained_on: task.
        evaluated_on: task.
        higher: whether more is better.
    """

    title: str
    metric: str
    trained_on: str
    evaluated_on: str
    higher: bool = True


@dataclass(frozen=True)
class Row:
    """One method of a table.

    Attributes:
        label: the paper's name of it; LocoTransformer where it prints "Ours".
        variant: ours.
        values: the paper's figures, one per column; None where it prints a dash.
    """

    label: str
    variant: Variant
    values: tuple[Value | None, ...]


@dataclass(frozen=True)
class PaperTable:
    """A table of the paper.

    Attributes:
        number: of the table.
        source: its LaTeX label in the paper.
        title: what it shows.
        columns: of figures.
        rows: of methods.
    """

    number: int
    source: str
    title: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]


POLICIES: Mapping[str, Variant] = {
    "State-Only": Variant("state-only"),
    "Depth-Only": Variant("depth-only"),
    "State-Depth-Concat": Variant("state-depth-concat"),
    "HRL": Variant("hrl"),
    "LocoTransformer": Variant("loco-transformer"),  # the paper prints "Ours"
}
THIN, WIDE, METRES, HITS = "Thin Obs.", "Wide Obs.", "Distance moved (m)", "Collisions"


def _rows(*values: tuple[Value | None, ...]) -> tuple[Row, ...]:
    """One row for each policy, in the paper's order."""
    return tuple(Row(label, POLICIES[label], cells) for label, cells in zip(POLICIES, values, strict=True))


def _transformer(**options: int) -> Variant:
    """The transformer with other sizes."""
    return Variant("loco-transformer", tuple((f"network.{key}", str(value)) for key, value in options.items()))


GENERALIZATION = PaperTable(
    1,
    "table:generalization",
    "Generalization to unseen environments",
    (
        Column(f"{METRES}, {THIN} (trained on {WIDE})", DISTANCE, "wide", "thin"),
        Column(f"{METRES}, {WIDE} (trained on {THIN})", DISTANCE, "thin", "wide"),
        Column(f"{HITS}, {THIN} (trained on {WIDE})", COLLISIONS, "wide", "thin", higher=False),
        Column(f"{HITS}, {WIDE} (trained on {THIN})", COLLISIONS, "thin", "wide", higher=False),
    ),
    _rows(
        ((3.6, 1.3), (5.9, 0.9), (456.3, 262.2), (545.1, 57.7)),
        ((1.1, 1.1), (0.1, 0.0), None, None),
        ((5.6, 2.1), (7.1, 2.0), (406.8, 89.5), (331.1, 192.8)),
        ((5.8, 2.2), (11.5, 1.8), (527.9, 94.6), (238.8, 59.5)),
        ((8.2, 2.5), (14.2, 2.8), (310.4, 131.3), (82.2, 103.8)),
    ),
)
SPHERE = PaperTable(
    2,
    "table:sphere",
    "Environments with spheres",
    tuple(
        Column(f"{title}, {name} & Sph.", metric, task, task, higher)
        for title, metric, higher in (
            (METRES, DISTANCE, True),
            ("Sphere reward", SPHERES, True),
            (HITS, COLLISIONS, False),
        )
        for name, task in ((THIN, "thin-sphere"), (WIDE, "wide-sphere"))
    ),
    _rows(
        ((5.6, 1.6), (7.4, 2.8), (80.0, 43.2), (80.0, 32.7), (450.2, 59.7), (556.5, 173.1)),
        ((0.0, 0.1), (5.2, 3.9), (0.0, 0.0), (33.3, 47.1), None, None),
        ((13.1, 2.3), (11.4, 3.3), (206.0, 41.1), (193.3, 24.9), (229.2, 65.3), (87.2, 40.7)),
        ((10.8, 0.8), (11.3, 2.9), (166.7, 54.4), (288.9, 154.8), (256.8, 87.4), (423.3, 170.0)),
        ((15.2, 1.8), (14.5, 0.7), (233.3, 47.1), (220.0, 33.2), (256.2, 70.0), (54.6, 20.8)),
    ),
)
MOVING = PaperTable(
    3,
    "table:moving",
    "Moving obstacles",
    (Column(METRES, DISTANCE, "moving", "moving"), Column(HITS, COLLISIONS, "moving", "moving", higher=False)),
    _rows(
        ((6.0, 1.3), (129.4, 25.4)),
        ((1.1, 1.1), None),
        ((16.3, 1.7), (88.4, 34.0)),
        ((7.1, 2.6), (75.8, 11.0)),
        ((11.3, 2.9), (67.9, 18.1)),
    ),
)
ABLATION = PaperTable(
    4,
    "table:ablation",
    f"Ablation on {THIN} & Sph.: N × N visual tokens, L encoder layers",
    (Column("Episode return", RETURN, "thin-sphere", "thin-sphere"),),
    (
        Row("LocoTransformer (N=1)", _transformer(tokens_per_side=1), ((1204.8, 243.6),)),
        Row("LocoTransformer (N=2)", _transformer(tokens_per_side=2), ((1418.1, 167.8),)),
        Row("LocoTransformer (N=4, L=2)", _transformer(), ((1551.5, 120.4),)),
        Row("LocoTransformer (L=1)", _transformer(layers=1), ((1509.7, 244.8),)),
        Row("LocoTransformer (L=3)", _transformer(layers=3), ((1423.5, 100.7),)),
    ),
)
MOUNTAIN = PaperTable(
    5,
    "table:mountain",
    "Mountain",
    (Column("3D distance moved (m)", DISTANCE, "mountain", "mountain"),),
    _rows(((3.7, 1.6),), ((3.0, 0.5),), ((4.7, 0.8),), ((6.3, 0.3),), ((6.8, 1.1),)),
)
TABLES = (GENERALIZATION, SPHERE, MOVING, ABLATION, MOUNTAIN)
