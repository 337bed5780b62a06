"""The complete settings of a run, as objects and as the ``config.yaml`` in its folder."""

from collections.abc import Mapping
from dataclasses import field, replace
from pathlib import Path
from typing import Annotated, Any

from fishrl.envs import AbstractTask
from fishrl.settings import TARGET, Role, Settings, build, describe, list_fields, suggest, to_plain
from fishrl.training.algorithms import Algorithm
from fishrl.training.algorithms.discrete_sac import DiscreteSAC
from fishrl.training.logger import CsvLogger
from fishrl.training.settings import LearningSettings, RunSettings


class Plan(Settings):
    """The complete settings of a run.

    Args:
        task: the task.
        algorithm: the learning algorithm.
        learning: settings that determine the result.
        run: where the run is written, and how often it evaluates, logs and saves.
        logger: writes the metrics.
        preset: name of the preset, for the files of the run.
        recognition: source of flow labels: None, ``oracle``, or the file of a classifier.
        extra: further settings of the caller, of other names, kept in ``config.yaml``.
    """

    task: AbstractTask
    algorithm: Algorithm = DiscreteSAC()
    learning: LearningSettings = LearningSettings()
    run: RunSettings = RunSettings()
    logger: Annotated[CsvLogger, Role.HARMLESS] = field(default_factory=CsvLogger)
    preset: str | None = None
    recognition: str | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check algorithm and ``extra``, and adapt the settings to the algorithm."""
        self.algorithm.check(self.task)
        for name in self.extra:
            if name in (*PARTS, *LEARNING, *RUN):
                raise ValueError(f"extra: {name} is a setting of the run itself; take another name")
        object.__setattr__(self, "learning", self.algorithm.adapt(self.learning))

    @property
    def name(self) -> str:
        """Name of the run folder."""
        words = (
            type(self.task).__name__.lower(),
            self.preset,
            self.algorithm.label,
            f"seed{self.learning.seed}",
        )
        return self.run.name or "-".join(word for word in words if word)

    @property
    def path(self) -> Path | None:
        """The run folder that ``run.name`` names; None for a new one."""
        folder, name = self.run.folder, self.run.name
        return None if name is None else Path(folder).expanduser() / name

    def to_config(self) -> dict[str, Any]:
        """Return the plan as plain data: ``PARTS`` nested, other settings at the top level."""
        parts = {name: to_plain(getattr(self, name)) for name in PARTS}
        flat = describe(self.learning) | describe(self.run)
        del flat[TARGET]
        return {**parts, **flat, **to_plain(self.extra)}

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> "Plan":
        """Make a plan from ``config.yaml`` or the metadata of a checkpoint; see ``to_config``.

        Missing entries keep their defaults. Modules outside fishrl that it names must have been
        imported, since a file cannot choose other code; errors are those of ``settings.build``.
        """
        node: dict[str, Any] = {name: config[name] for name in PARTS if name in config}
        for name, kind, known in (
            ("learning", LearningSettings, LEARNING),
            ("run", RunSettings, RUN),
        ):
            node[name] = build(kind, {key: config[key] for key in known if key in config})
        own = (*PARTS, *LEARNING, *RUN)
        node["extra"] = {name: value for name, value in config.items() if name not in own}
        return build(cls, node)

    def change(self, **changes: Any) -> "Plan":
        """Return the plan with other settings of ``RunSettings`` or ``extra``, which may change."""
        for name in changes:
            if name in (*LEARNING, *PARTS):
                raise ValueError(f"{name}: is fixed in a run that has begun; start a new run")
            if name not in RUN and name not in self.extra:
                raise ValueError(f"{name}: no such setting{suggest(name, (*RUN, *self.extra))}")
        of_run = {name: value for name, value in changes.items() if name in RUN}
        extra = {name: value for name, value in changes.items() if name not in RUN}
        return replace(self, run=replace(self.run, **of_run), extra={**self.extra, **extra})


#: Names of the settings of learning, of the run, and of the other parts of a plan; those of
#: ``LEARNING`` and ``PARTS`` are fixed once a run has begun.
LEARNING = tuple(entry.name for entry in list_fields(LearningSettings))
RUN = tuple(entry.name for entry in list_fields(RunSettings))
PARTS = tuple(
    entry.name for entry in list_fields(Plan) if entry.name not in ("learning", "run", "extra")
)
