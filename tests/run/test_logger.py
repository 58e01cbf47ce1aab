import csv

import pytest

from loco_mjx.run.logger import Logger, read_rows
from tests.refusals import refusal


def table(directory):
    with (directory / "metrics.csv").open() as file:
        return list(csv.DictReader(file))


def write(directory, step, **metrics):
    logger = Logger(directory, step)
    for i in range(3):
        logger.write(step + 10 * (i + 1), metrics)
    logger.close()


def test_rows_beyond_the_resumed_step_are_dropped(tmp_path):
    write(tmp_path, 0, loss=1.0)
    write(tmp_path, 20, loss=2.0)
    assert [(row["step"], row["loss"]) for row in table(tmp_path)] == [
        ("10", "1.0"),
        ("20", "1.0"),
        ("30", "2.0"),
        ("40", "2.0"),
        ("50", "2.0"),
    ]


def test_a_row_cut_short_by_a_kill_is_dropped(tmp_path):
    write(tmp_path, 0, loss=1.0, gain=2.0)
    with (tmp_path / "metrics.csv").open("a") as file:
        file.write("40,1.")
    assert [row["step"] for row in read_rows(tmp_path / "metrics.csv")] == ["10", "20", "30"]


def test_a_metric_that_appears_later_gets_a_column_and_earlier_rows_leave_it_empty(tmp_path):
    logger = Logger(tmp_path, 0)
    logger.write(1, {"loss": 1.0})
    logger.write(2, {"loss": 2.0, "eval/distance": 3.0})
    logger.write(3, {"loss": 4.0})
    logger.close()
    assert [row["eval/distance"] for row in table(tmp_path)] == ["", "3.0", ""]
    assert [row["loss"] for row in table(tmp_path)] == ["1.0", "2.0", "4.0"]


def test_numbers_are_written_exactly(tmp_path):
    logger = Logger(tmp_path, 0)
    logger.write(1, {"loss": 0.1 + 0.2})
    logger.close()
    assert float(table(tmp_path)[0]["loss"]) == 0.1 + 0.2


def test_training_time_adds_up_over_starts(tmp_path):
    write(tmp_path, 0, **{"time/seconds": 12.5})
    logger = Logger(tmp_path, 30)
    assert logger.seconds == 12.5
    logger.close()


def test_curves_go_to_tensorboard_too(tmp_path):
    write(tmp_path, 0, loss=1.0)
    (events,) = (tmp_path / "tensorboard").iterdir()
    assert b"loss" in events.read_bytes()


HARMS = {
    "byte": lambda content: content.replace(b"20,1.5", b"20,\xff.5"),
    "digit": lambda content: content.replace(b"20,1.5", b"20,2.5"),
    "step": lambda content: content.replace(b"20,1.5", b"21,1.5"),
    "row": lambda content: content.replace(b"20,1.5\r\n", b""),
    "twice": lambda content: content.replace(b"20,1.5\r\n", b"20,1.5\r\n20,1.5\r\n"),
    "header": lambda content: content.replace(b"step", b"stap"),
    "column": lambda content: content.replace(b"loss", b"lo\xffss"),
    "cells": lambda content: content.replace(b"20,1.5", b"20,1.5,7"),
    "zeros": lambda content: bytes(len(content)),
    "long": lambda content: content + b"9" * 200_000 + b"\r\n",
    "empty": lambda content: b"",
}


@pytest.mark.parametrize("harm", HARMS.values(), ids=HARMS.keys())
def test_rows_that_were_changed_come_back_from_the_checkpoint(tmp_path, harm):
    path, said = tmp_path / "metrics.csv", []
    write(tmp_path, 0, loss=1.5)
    kept = path.read_text()
    assert Logger(tmp_path, 30, kept, said.append).seconds == 0.0 and said == []
    path.write_bytes(harm(path.read_bytes()))
    harmed = path.read_bytes()
    read_rows(path)  # those who draw it get what can be read
    logger = Logger(tmp_path, 30, kept, said.append)
    assert path.read_bytes() == harmed  # nothing is written before the run goes on
    logger.write(40, {"loss": 2.0})
    logger.close()
    assert [(row["step"], row["loss"]) for row in table(tmp_path)] == [
        *((step, "1.5") for step in ("10", "20", "30")),
        ("40", "2.0"),
    ]
    assert len(said) == 1 and "metrics.csv.changed" in said[0]
    assert (tmp_path / "metrics.csv.changed").read_bytes() == harmed


@pytest.mark.parametrize("name", ["byte", "row", "header", "cells", "zeros"])
def test_without_a_checkpoints_copy_what_can_be_read_is_kept(tmp_path, name):
    path, said = tmp_path / "metrics.csv", []
    write(tmp_path, 0, loss=1.5)
    path.write_bytes(HARMS[name](path.read_bytes()))
    logger = Logger(tmp_path, 30, None, said.append)
    logger.open()
    logger.close()
    assert [row["step"] for row in table(tmp_path)] == ([] if name in ("header", "zeros") else ["10", "30"])
    assert bool(said) == (name not in ("row", "zeros"))


def test_what_lies_behind_a_link_in_the_place_of_a_partial_file_is_not_touched(tmp_path):
    (tmp_path / "precious").write_text("data")
    (tmp_path / "metrics.csv.partial").symlink_to("precious")
    (tmp_path / "metrics.csv").symlink_to("precious")
    write(tmp_path, 0, loss=1.0)
    assert (tmp_path / "precious").read_text() == "data" and len(table(tmp_path)) == 3


def test_curves_that_cannot_be_read_are_one_line(tmp_path):
    (tmp_path / "metrics.csv").mkdir()
    with refusal(f"{tmp_path}/metrics.csv directory"):
        Logger(tmp_path, 0)
