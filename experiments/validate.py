"""Every case against the literature, by one command: ``python -m experiments.validate``.

Runs the cases' jobs side by side, one core each, and writes ``docs/validation.md`` with a figure
per case; with ``--quick`` or a choice of ``--cases`` the page goes into the folder instead. What is
finished stays in the folder: the same command goes on after an interruption, and runs only what a
change to the physics or to a case has made stale. Ends with status 1 if a bar is missed.
"""

from __future__ import annotations

import argparse
import difflib
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from experiments.command_line import plain_errors, set_up_logging
from experiments.validation.case import MISSED, Case
from experiments.validation.catalogue import CASES
from experiments.validation.report import render_table, summarise, write_report
from experiments.validation.runner import run_cases


def choose_cases(names: Sequence[str], cases: Sequence[Case]) -> list[Case]:
    """Return the cases called so, or all if no name is given.

    Raises:
        ValueError: if there is no case of a name.
    """
    known = {case.name: case for case in cases}
    for name in names:
        if name not in known:
            near = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.4)
            hint = f" Did you mean {near[0]}?" if near else ""
            raise ValueError(f"no case '{name}'.{hint} The cases are: {', '.join(known)}")
    return [known[name] for name in dict.fromkeys(names)] if names else list(cases)


def validate(
    cases: Sequence[Case],
    *,
    folder: Path,
    docs: Path | None = None,
    quick: bool = False,
    num_workers: int = 1,
    is_fresh: bool = False,
) -> bool:
    """Run, judge and report some cases; return whether no bar was missed.

    Args:
        cases: which.
        folder: of the results, and of the page if there is no ``docs``.
        docs: folder that takes ``validation.md`` and ``figures/validation``.
        quick: run the quick jobs only.
        num_workers: jobs at a time.
        is_fresh: run again what is known.
    """
    outcomes = run_cases(
        cases, folder=folder, quick=quick, num_workers=num_workers, is_fresh=is_fresh
    )
    page = (docs or folder) / "validation.md"
    command = "make validate" if docs else "python -m experiments.validate"
    write_report(outcomes, page=page, json_path=folder / "validation.json", command=command)
    print(render_table(outcomes))
    print(f"\n{summarise(outcomes)} Written to {page}")
    return all(check.verdict != MISSED for outcome in outcomes for check in outcome.checks)


@contextmanager
def resumable() -> Iterator[None]:
    """Say how to go on if the program is interrupted or told to end."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    except KeyboardInterrupt:
        print("interrupted; finished runs are kept: the same command goes on", file=sys.stderr)
        sys.exit(130)
    finally:
        signal.signal(signal.SIGTERM, before)


def main(cases: Sequence[Case] = CASES) -> None:
    """Read the command line, validate, and end with status 1 if a bar was missed."""
    names = ", ".join(case.name for case in cases)
    parser = argparse.ArgumentParser(description="Judge the flow solver by the literature.")
    parser.add_argument("--quick", action="store_true", help="coarse runs only, a minute or so")
    parser.add_argument("--cases", nargs="+", default=[], metavar="CASE", help=f"some of: {names}")
    parser.add_argument("--folder", type=Path, default=Path("runs/validation"))
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes at a time")
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="where the page goes")
    parser.add_argument("--fresh", action="store_true", help="run again what is known")
    options = parser.parse_args()
    set_up_logging()
    with plain_errors(), resumable():
        is_full = not options.quick and not options.cases
        is_passed = validate(
            choose_cases(options.cases, cases),
            folder=options.folder,
            docs=options.docs if is_full else None,
            quick=options.quick,
            num_workers=options.jobs,
            is_fresh=options.fresh,
        )
    sys.exit(0 if is_passed else 1)


if __name__ == "__main__":
    main()
