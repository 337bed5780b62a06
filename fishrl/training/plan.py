"""The complete settings of a run, as objects and as the ``config.yaml`` in its folder."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from fishrl.bounds import suggest
from fishrl.envs import AbstractTask
from fishrl.training.algorithms import Algorithm
from fishrl.training.algorithms.discrete_sac import DiscreteSAC
from fishrl.training.aliases import FORMER_SETTINGS, update_config
from fishrl.training.description import describe, make, to_plain
from fishrl.training.logger import CsvLogger
from fishrl.training.settings import LearningSettings, RunSettings

LEARNING = tuple(entry.name for entry in fields(LearningSettings))
RUN = tuple(entry.name for entry in fields(RunSettings))
#: Fixed once a run has begun, like ``LEARNING``.
PARTS = ("task", "algorithm", "logger", "preset", "recognition")
#: Those of a run, apart from ``extra``.
SETTINGS = {*LEARNING, *RUN, *PARTS, *FORMER_SETTINGS}


@dataclass(frozen=True, kw_only=True)
class Plan:
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
    algorithm: Algorithm = field(default_factory=DiscreteSAC)
    learning: LearningSettings = field(default_factory=LearningSettings)
    run: RunSettings = field(default_factory=RunSettings)
    logger: CsvLogger = field(default_factory=CsvLogger)
    preset: str | None = None
    recognition: str | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check algorithm and ``extra``, and adapt the settings to the algorithm."""
        self.algorithm.check(self.task)
        for name in self.extra:
            if name in SETTINGS:
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

    def to_config(self) -> dict[str, Any]:
        """Return the plan as nested plain values, settings at the top level."""
        return {
            "task": describe(self.task),
            "algorithm": describe(self.algorithm),
            "logger": describe(self.logger),
            "preset": self.preset,
            "recognition": self.recognition,
            **to_plain(asdict(self.learning)),
            **to_plain(asdict(self.run)),
            **to_plain(self.extra),
        }

    @classmethod
    def from_config(cls, config: Mapping[str, Any], *, modules: Collection[str] = ()) -> Plan:
        """Make a plan from ``config.yaml`` or the metadata of a checkpoint; see ``to_config``.

        Missing entries keep their defaults; ``modules`` see ``description.make``, like the errors.
        """
        config = update_config(config)
        logger = config.get("logger") or describe(CsvLogger())
        try:
            learning = LearningSettings(**{n: config[n] for n in LEARNING if n in config})
            run = RunSettings(**{n: config[n] for n in RUN if n in config})
        except TypeError as error:
            raise ValueError(f"settings of the run: {error}") from error
        return cls(
            task=make(config.get("task"), kind=AbstractTask, modules=modules),
            algorithm=make(config["algorithm"], kind=Algorithm, modules=modules),
            learning=learning,
            run=run,
            logger=make(logger, kind=CsvLogger, modules=modules),
            preset=config.get("preset"),
            recognition=config.get("recognition"),
            extra={name: value for name, value in config.items() if name not in SETTINGS},
        )

    def change(self, **changes: Any) -> Plan:
        """Return the plan with other settings of ``RunSettings`` or ``extra``, which may change."""
        for name in changes:
            if name in (*LEARNING, *PARTS):
                raise ValueError(f"{name}: is fixed in a run that has begun; start a new run")
            if name not in RUN and name not in self.extra:
                raise ValueError(f"{name}: no such setting{suggest(name, (*RUN, *self.extra))}")
        of_run = {name: value for name, value in changes.items() if name in RUN}
        extra = {name: value for name, value in changes.items() if name not in RUN}
        return replace(self, run=replace(self.run, **of_run), extra={**self.extra, **extra})
