"""Settings of programs that show flows."""

from dataclasses import dataclass

from fishrl.bounds import Checked, bounded, suggest
from fishrl.envs.views import FIELDS
from fishrl.viewer.drawing import FieldFormat


@dataclass(frozen=True, kw_only=True)
class ViewerSettings(Checked):
    """Which flows are shown, how often and how.

    Args:
        live: stream to a viewer on this machine (127.0.0.1) while the flows run.
        flows: which flows of the batch to show, each in a tab of its own.
        frames_per_T: frames per period, approximately; they coincide with checks for termination.
        field: vorticity (1/T), pressure (rho L^2/T^2) or speed (L/T).
        field_format: format of the field, jpeg (small) or u8 (values under the mouse).
        field_limit: value at which the field's colours saturate; by default 15 for the vorticity,
            and limits that follow from the fastest stream for pressure and speed; films and figures
            choose one that suits the wake.
        port: port of the live viewer; the next free one if it is taken.
        live_share: largest share of the wall time that a live view may take.
    """

    live: bool = False
    flows: list[int] | None = None
    frames_per_T: int = bounded(8, least=1)
    field: str = "vorticity"
    field_format: str = "jpeg"
    field_limit: float | None = bounded(None, greater=0)
    port: int = bounded(9876, least=1024, largest=65000)
    live_share: float = bounded(0.1, greater=0, largest=1)

    def __post_init__(self) -> None:
        """Check the bounds, the field and its format."""
        super().__post_init__()
        choices = {"field": FIELDS, "field_format": [str(one) for one in FieldFormat]}
        for name, known in choices.items():
            value = getattr(self, name)
            if value not in known:
                raise ValueError(
                    f"{name} = {value}: must be one of {', '.join(known)}{suggest(value, known)}"
                )

    def choose_flows(self, num: int, *, default: int) -> list[int]:
        """Return which of ``num`` flows to show, by default the first ``default`` ones."""
        flows = list(range(default)) if self.flows is None else list(self.flows)
        if not flows or not all(0 <= flow < num for flow in flows) or len(set(flows)) < len(flows):
            raise ValueError(f"flows = {flows}: must be some of 0 to {num - 1}, each once")
        return flows
