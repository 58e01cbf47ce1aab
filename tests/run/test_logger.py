import csv

from loco_mjx.run.logger import Logger, read_rows


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
