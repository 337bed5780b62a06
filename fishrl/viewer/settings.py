"""Settings of programs that show flows."""

from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, PositiveInt

from fishrl.settings import Role, Settings

#: How the field is stored: ``jpeg`` small, with fixed colours; ``u8`` larger, with 255 levels: the
#: viewer shows values under the mouse and chooses the colour map.
FieldFormat = Literal["jpeg", "u8"]


class ViewerSettings(Settings):
    """Which flows are shown, how often and how.

    Args:
        live: stream to a viewer on this machine (127.0.0.1) while the flows run.
        flows: flows of the batch to show, each in its own tab.
        frames_per_T: frames per period, approximately; they coincide with checks for termination.
        field: vorticity (1/T), pressure (rho L^2/T^2) or speed (L/T).
        field_format: format of the field, jpeg (small) or u8 (values under the mouse).
        field_limit: value at which the field's colours saturate; by default 15 for the vorticity,
            and limits that follow from the fastest stream for pressure and speed; films and figures
            choose one that suits the wake.
        port: port of the live viewer; the next free one if it is taken.
        live_share: largest share of the wall time that a live view may take.
    """

    live: Annotated[bool, Role.HARMLESS] = False
    flows: Annotated[tuple[int, ...] | None, Role.HARMLESS] = None
    frames_per_T: Annotated[PositiveInt, Role.HARMLESS] = 8
    field: Annotated[Literal["vorticity", "pressure", "speed"], Role.HARMLESS] = "vorticity"
    field_format: Annotated[FieldFormat, Role.HARMLESS] = "jpeg"
    field_limit: Annotated[PositiveFloat | None, Role.HARMLESS] = None
    port: Annotated[int, Field(ge=1024, le=65000), Role.HARMLESS] = 9876
    live_share: Annotated[PositiveFloat, Field(le=1), Role.HARMLESS] = 0.1

    def choose_flows(self, num: int, *, default: int) -> list[int]:
        """Return which of ``num`` flows to show, by default the first ``default`` ones."""
        flows = list(range(default)) if self.flows is None else list(self.flows)
        if not flows or not all(0 <= flow < num for flow in flows) or len(set(flows)) < len(flows):
            raise ValueError(f"flows = {flows}: must be some of 0 to {num - 1}, each once")
        return flows
