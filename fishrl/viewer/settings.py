"""Settings of live views, recordings and films."""

from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, PositiveInt

from fishrl.settings import Role, Settings

#: Storage of the field: ``jpeg`` is small and has fixed colours; ``u8`` stores 255 levels, from
#: which the viewer shows values under the mouse with any colour map.
FieldFormat = Literal["jpeg", "u8"]


class ViewerSettings(Settings):
    """Settings of the viewer.

    Args:
        live: stream to a viewer on this machine (127.0.0.1) while the flows run.
        shown_flows: indices of the flows to show, each in a tab.
        frames_per_T: approximate frames per period; frames coincide with checks for termination.
        field: vorticity (1/T), pressure (rho L^2/T^2) or speed (L/T).
        field_format: format of the field, jpeg (small) or u8 (values under the mouse).
        field_limit: value at which the colours of the field saturate; by default 15 for vorticity
            and a value for the fastest stream for pressure and speed; films and figures choose one
            for the wake.
        shows_levels: with levels, draw the outlines of finer grids, and a dot wherever their lower
            left corners were in earlier frames.
        port: port of the live viewer; the next free one if it is taken.
        live_share: largest share of the wall time that the live view may take.
    """

    live: Annotated[bool, Role.HARMLESS] = False
    shown_flows: Annotated[tuple[int, ...] | None, Role.HARMLESS] = None
    frames_per_T: Annotated[PositiveInt, Role.HARMLESS] = 8
    field: Annotated[Literal["vorticity", "pressure", "speed"], Role.HARMLESS] = "vorticity"
    field_format: Annotated[FieldFormat, Role.HARMLESS] = "jpeg"
    field_limit: Annotated[PositiveFloat | None, Role.HARMLESS] = None
    shows_levels: Annotated[bool, Role.HARMLESS] = False
    port: Annotated[int, Field(ge=1024, le=65000), Role.HARMLESS] = 9876
    live_share: Annotated[PositiveFloat, Field(le=1), Role.HARMLESS] = 0.1

    def choose_flows(self, num: int, *, default: int) -> list[int]:
        """Return the indices of the flows to show, by default the first ``default`` of ``num``."""
        flows = list(range(default) if self.shown_flows is None else self.shown_flows)
        if not flows or not all(0 <= flow < num for flow in flows) or len(set(flows)) < len(flows):
            raise ValueError(f"shown_flows = {flows}: must be some of 0 to {num - 1}, each once")
        return flows
