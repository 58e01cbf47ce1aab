"""What training shows, by a clock of the tests' own."""

import io

from rich.console import Console

from loco_mjx.run.progress import Reporter
from tests.refusals import says

COMPILING, ITERATION, EVALUATION = 60.0, 6.0, 30.0  # s


def lines(total, iterations, terminal=False):
    """The lines after each of some iterations of 100 samples; the first one compiles, every third one evaluates."""
    page, now = io.StringIO(), 0.0
    reporter = Reporter(Console(file=page, force_terminal=terminal, width=200), total, 0, clock=lambda: now)
    for i in range(iterations):
        now += ITERATION + (COMPILING if i == 0 else 0.0) + (EVALUATION if i % 3 == 2 else 0.0)
        seconds = ITERATION + (COMPILING if i == 0 else 0.0)
        reporter.update(100 * (i + 1), 100 / seconds, {"episode/return": float(i)})
    reporter.close()
    return page.getvalue().splitlines()


def test_the_time_left_is_not_guessed_from_the_compilation():
    first, second = lines(1100, 2)
    assert says(first, "100/1,100 return 0.0") and not says(first, "s")
    # 9 iterations of 6 s; with the compilation in it, it would be 5 min.
    assert says(second, "200/1,100 17 54 s return 1.0")


def test_evaluations_are_part_of_the_time_left():
    *_, last = lines(700, 4)
    assert says(last, "48 s")  # as the 300 samples since the first iteration: 3 × 6 s and an evaluation of 30 s


def test_what_is_done_takes_no_more_time():
    (line,) = lines(100, 1)
    assert says(line, "100/100 0 s return 0.0")


def test_whoever_knows_better_says_how_long_it_takes():
    page = io.StringIO()
    reporter = Reporter(Console(file=page, width=200), 300, 0, clock=lambda: 0.0)
    reporter.update(100, 10.0, {}, left=50.0)
    reporter.update(300, 10.0, {}, left=20.0)  # all is trained, but not all is done
    first, second = page.getvalue().splitlines()
    assert says(first, "100/300 50 s") and says(second, "300/300 10 20 s")


def test_a_terminal_is_told_the_same():
    first, second = ("\n".join(lines(1100, count, terminal=True)) for count in (1, 2))
    assert not says(first, "54") and says(second, "54 s")
