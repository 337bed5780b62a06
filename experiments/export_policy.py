"""Export a learned policy: ``python -m experiments.export_policy run=runs/<name> folder=<folder>``.

Writes its weights, settings, learning curve, final evaluation and model card, without what only its
training needs; every program takes the folder as ``checkpoint=<folder>``.
"""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

from omegaconf import MISSING

from experiments.program import program
from fishrl.training.export import export_policy


@dataclass(kw_only=True)
class ExportPolicySettings:
    """Settings of an export.

    Args:
        run: folder of a run.
        folder: to write.
        title: of the model card; by default the name of the folder.
    """

    run: str = MISSING
    folder: str = MISSING
    title: str | None = None


def read_revision() -> str | None:
    """Return the commit of this code, or None where it is not a git checkout."""
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    return done.stdout.strip() or None


@program(ExportPolicySettings)
def main(settings: ExportPolicySettings) -> None:
    """Export and say where."""
    folder = export_policy(
        settings.run, settings.folder, title=settings.title, revision=read_revision()
    )
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    print(f"written to {folder}: {size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
