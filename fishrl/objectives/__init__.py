"""Losses the brains learn by."""

from fishrl.objectives.discrete_sac import MaskedDiscreteSACLoss

__all__ = ["MaskedDiscreteSACLoss"]
