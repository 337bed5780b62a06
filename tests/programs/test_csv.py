"""Tables that are opened in a spreadsheet."""

import csv
import random
import re
from pathlib import Path

from fishrl.pages import write_csv
from tests.wrong_files import ATTEMPTS

FORMULA = tuple("=+-@＝＋－＠")
STARTS = (*FORMULA, " =", "\t=", "\r=", "\n=", "", "a", "'", '"', "-1", "+1e", "-inf", "nan")
WORDS = ("cmd|'/C calc'!A0", "SUM(1,2)", "5", "e9", "", ";=1", '","=1', "-1", "inf")


def test_no_words_of_others_are_a_formula_and_numbers_stay(tmp_path: Path) -> None:
    rng = random.Random(0)
    cells = [rng.choice(STARTS) + rng.choice(WORDS) for _ in range(10 * ATTEMPTS)]
    write_csv(tmp_path / "table.csv", ["=1"], [[cell, -0.5] for cell in cells])
    with (tmp_path / "table.csv").open(newline="", encoding="utf-8") as file:
        read = [row[0] for row in csv.reader(file) if row[1:] in ([], ["-0.5"])]
    for cell, got in zip(("=1", *cells), read, strict=True):
        is_number = re.fullmatch(r"[+-](\d+(e[+-]?\d+)?|inf)", cell)
        assert got == (f"'{cell}" if cell.strip()[:1] in FORMULA and not is_number else cell)
