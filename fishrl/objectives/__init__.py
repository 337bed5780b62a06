"""Losses of the algorithms, and the fit of the lateral-line classifier."""

from fishrl.objectives.classification import (
    Curves,
    FitSettings,
    Score,
    fit_classifier,
    score_classifier,
    split_episodes,
)
from fishrl.objectives.discrete_sac import MaskedDiscreteSACLoss
from fishrl.objectives.dqn import MaskedDQNLoss, RecurrentDQNLoss

__all__ = [
    "Curves",
    "FitSettings",
    "MaskedDQNLoss",
    "MaskedDiscreteSACLoss",
    "RecurrentDQNLoss",
    "Score",
    "fit_classifier",
    "score_classifier",
    "split_episodes",
]
