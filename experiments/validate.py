"""Validate the flow solver against the literature: ``python -m experiments.validate``.

Runs the jobs of all cases in parallel, one core each, and writes ``docs/validation.md`` and each
case's results and figure, from which ``make docs`` builds its page; with ``quick=true`` or a choice
of ``cases`` they go into the folder instead. Results are cached in the folder: the same command
continues after an interruption, and repeats only jobs that a change to the physics or to a case
affects. Exits with status 1 if a criterion fails.
"""

import sys
from importlib import import_module
from pathlib import Path

from pydantic import PositiveInt

from experiments.validation.case import MISSED, Case
from experiments.validation.report import list_rows, render_checks, summarise, write_report
from experiments.validation.runner import run_cases
from fishrl.files import claim
from fishrl.limits import count_cores
from fishrl.programs.export_policy import read_revision
from fishrl.programs.program import program
from fishrl.settings import Settings, unknown

# in the order of the report
NAMES = (
    *("taylor_green", "poiseuille", "cavity", "invariance", "slip", "channel_cylinder"),
    *("free_cylinder", "d_cylinder", "edges", "oscillating_cylinder"),
    *("conservation", "rotating_cylinder", "settling_disc", "sheared_ellipse", "swimmer"),
    *("sharp_swimmer", "levels", "energy_budget"),
    *("gaits", "turning", "pitching_pair", "c_start", "compressibility", "stability"),
)
CASES: tuple[Case, ...] = tuple(
    import_module(f"experiments.validation.{name}").CASE for name in NAMES
)


class ValidateSettings(Settings):
    """Settings of a validation.

    Args:
        cases: names of cases; by default all.
        quick: coarse runs only, some three minutes with empty caches.
        fresh: repeat cached jobs too.
        jobs: parallel processes.
        folder: folder of the cached results, and of the report unless all cases run.
        docs: folder for the report of a full run.
    """

    cases: tuple[str, ...] = ()
    quick: bool = False
    fresh: bool = False
    jobs: PositiveInt = count_cores()
    folder: str = "runs/validation"
    docs: str = "docs"

    def __post_init__(self) -> None:
        """Check names and numbers."""
        super().__post_init__()
        names = [case.name for case in CASES]
        for name in self.cases:
            if name not in names:
                raise unknown(name, names)
        quick = [case.name for case in CASES if any(job.is_quick for job in case.jobs)]
        if self.quick and self.cases and not {*self.cases} & {*quick}:
            raise ValueError(f"cases = {[*self.cases]}: quick=true has {', '.join(quick)} alone")


@program()
def main(settings: ValidateSettings) -> None:
    """Run, check and report the cases."""
    folder = Path(settings.folder)
    is_full = not settings.quick and not settings.cases
    docs = Path(settings.docs) if is_full else folder
    with claim(docs / "validation.md"):
        outcomes = run_cases(
            [case for case in CASES if case.name in settings.cases or not settings.cases],
            folder=folder,
            quick=settings.quick,
            num_workers=settings.jobs,
            is_fresh=settings.fresh,
        )
        command = "make validate" if is_full else "python -m experiments.validate"
        commit = (read_revision() or "unknown")[:8]
        write_report(outcomes, folder=docs, command=command, commit=commit)
    rows = list_rows(check for outcome in outcomes for check in outcome.checks)
    print(f"{render_checks(outcomes)}\n{summarise(rows)} Written to {docs / 'validation.md'}")
    if any(row["verdict"] == MISSED for row in rows):
        sys.exit(1)


if __name__ == "__main__":
    main()
