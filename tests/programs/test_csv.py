"""Tables that are opened in a spreadsheet."""

import csv
import random
from pathlib import Path

from fishrl.pages import write_csv
from tests.wrong_files import ATTEMPTS

STARTS = (*"=+-@＝＋－＠", " =", "\t=", "\r=", "\n=", "", "a", "'", '"', "-1", "+1e", "-inf", "nan")
WORDS = ("cmd|'/C calc'!A0", "SUM(1,2)", "5", "e9", "", ";=1", '","=1', "-1", "inf")


def test_no_words_of_others_are_a_formula_and_numbers_stay(tmp_path: Path) -> None:
    rng = random.Random(0)
    cells = [rng.choice(STARTS) + rng.choice(WORDS) for _ in range(10 * ATTEMPTS)]
    numbers = [-1, -0.5, float("-inf"), 1e-7, True, None]
    write_csv(tmp_path / "table.csv", ["=1"], [[cell] for cell in (*cells, *numbers)])
    with (tmp_path / "table.csv").open(newline="", encoding="utf-8") as file:
        (head,), *rows = csv.reader(file)
    read = [cell for row in rows for cell in row or [""]]
    assert head == "'=1" and read[len(cells) :] == ["-1", "-0.5", "-inf", "1e-07", "True", ""]
    for cell, got in zip(cells, read, strict=False):
        assert got in (cell, f"'{cell}")
        try:
            float(got)
        except ValueError:
            assert got.strip()[:1] not in "=+-@＝＋－＠" or not got
