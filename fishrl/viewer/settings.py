"""Settings of whatever shows flows."""

from dataclasses import dataclass

from fishrl.bounds import bounded, check_bounds, suggest
from fishrl.viewer.drawing import FieldFormat


@dataclass(frozen=True, kw_only=True)
class ViewerSettings:
    """Which flows are shown, how often and how.

    Args:
        live: stream to a viewer on this machine (127.0.0.1) while the flows run.
        flows: which flows of the batch to show, each in a tab of its own.
        frames_per_T: frames per period, approximately; they coincide with checks for termination.
        field_format: of the vorticity: jpeg (small) or u8 (values under the mouse).
        vorticity_limit: at which the colours saturate, 1/T.
        port: of the live viewer; the next free one if it is taken.
        live_share: of the wall time that a live view may take from a training or an evaluation.
    """

    live: bool = False
    flows: list[int] | None = None
    frames_per_T: int = bounded(8, least=1)
    field_format: str = "jpeg"
    vorticity_limit: float = bounded(15.0, greater=0)
    port: int = bounded(9876, least=1024, largest=65000)
    live_share: float = bounded(0.1, greater=0, largest=1)

    def __post_init__(self) -> None:
        """Check the bounds and the format."""
        check_bounds(self)
        known = [str(one) for one in FieldFormat]
        if self.field_format not in known:
            raise ValueError(
                f"field_format = {self.field_format}: must be one of {', '.join(known)}"
                f"{suggest(self.field_format, known)}"
            )

    def choose_flows(self, num: int, *, default: int) -> list[int]:
        """Return which of ``num`` flows to show, by default the first ``default`` ones."""
        flows = list(range(default)) if self.flows is None else list(self.flows)
        if not flows or not all(0 <= flow < num for flow in flows) or len(set(flows)) < len(flows):
            raise ValueError(f"flows = {flows}: must be some of 0 to {num - 1}, each once")
        return flows
