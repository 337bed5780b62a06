"""The scene that a task draws: plain data, independent of any viewer.

A ``Scene`` says once what is drawn, in what colours and units; a ``Frame`` holds one moment's
tensors under the keys that the scene names. Places are (x, y) in nodes, y upward; times in T.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

from torch import Tensor

Colour = tuple[int, int, int]


@dataclass(frozen=True, kw_only=True)
class Field:
    """A field over the whole grid, ``[Y, X]``.

    Args:
        key: key of its tensor in each frame.
        name: name in the legend.
        unit: unit of its values.
        limit: value at which the colours saturate.
        note: meaning of the sign.
        is_signed: colours diverge around zero; otherwise they begin at zero.
        saturated: share of the values beyond the limit that a film chooses; None for ``limit``.
    """

    key: str
    name: str
    unit: str
    limit: float
    note: str = ""
    is_signed: bool = True
    saturated: float | None = 0.0

    def __post_init__(self) -> None:
        if not self.limit > 0.0:
            raise ValueError(f"the limit of {self.name} is {self.limit}: must be positive")

    @property
    def low(self) -> float:
        """The value at the lower end of the colours."""
        return -self.limit if self.is_signed else 0.0


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A curve ``[N, 2]``: closed and filled, or an open line such as a midline.

    Args:
        key: key of its tensor.
        colour: RGB colour of the line and the filling.
        is_closed: whether the last point joins the first; a closed curve is filled.
        order: curves of higher order lie above.
    """

    key: str
    colour: Colour
    is_closed: bool = True
    order: float = 4.0


@dataclass(frozen=True, kw_only=True)
class Marks:
    """Points ``[P, 2]`` or one point ``[2]``, in one colour or coloured by a value each.

    Args:
        key: key of their tensor.
        radius: radius of a point, nodes.
        colour: RGB colour of points without values.
        value: key of the values ``[P]``; they are drawn in diverging colours around zero.
        name: name of the value in the legend.
        unit: unit of the value.
        limit: value at which the colours saturate.
        reach: radius of a circle around each, nodes; 0 draws none.
    """

    key: str
    radius: float
    colour: Colour = (120, 120, 120)
    value: str | None = None
    name: str = ""
    unit: str = ""
    limit: float = 1.0
    reach: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Arrow:
    """A vector ``[2]`` drawn as an arrow, such as the force on a body.

    Args:
        key: key of the vector.
        at: key of the point ``[2]`` where it begins.
        scale: nodes per unit of the vector.
        colour: RGB colour of the arrow.
    """

    key: str
    at: str
    scale: float
    colour: Colour = (0, 158, 115)


@dataclass(frozen=True, kw_only=True)
class Trail:
    """The path of a point ``[2]`` since its episode began.

    Args:
        key: key of the point.
        colour: RGB colour of the line.
        length_T: how far back it reaches.
    """

    key: str
    colour: Colour = (90, 90, 90)
    length_T: float = 30.0


@dataclass(frozen=True, kw_only=True)
class Area:
    """A fixed rectangle that the fish must not leave.

    Args:
        key: its name.
        low: corner (x, y) in nodes.
        high: the opposite corner.
        colour: RGB colour of its border and of the strokes outside.
    """

    key: str
    low: tuple[float, float]
    high: tuple[float, float]
    colour: Colour = (200, 30, 40)


@dataclass(frozen=True, kw_only=True)
class Series:
    """One line of a plot.

    Args:
        key: key of its tensor.
        label: label in the legend.
        column: index into the tensor; None if it is a single number.
        is_rate: draw its change per T since the previous frame instead.
        colour: RGB colour of the line; by default the viewer chooses.
    """

    key: str
    label: str
    column: int | None = None
    is_rate: bool = False
    colour: Colour | None = None


@dataclass(frozen=True, kw_only=True)
class Panel:
    """A plot over time. NaN, and what a frame does not hold, is left out.

    Args:
        name: name of the plot, with its unit.
        series: its lines.
        span: range of the vertical axis; by default the range of the values.
        is_step: values hold since the previous frame, rather than at an instant.
        is_output: the keys are entries of the env's output rather than of ``views.read_scene``; the
            plot is left out where the env has no such entry.
        is_log: draw sign(x) log2(1 + abs(x)), in which 1 is 1 and small values show next to large
            ones.
    """

    name: str
    series: tuple[Series, ...]
    span: tuple[float, float] | None = None
    is_step: bool = False
    is_output: bool = False
    is_log: bool = False


@dataclass(frozen=True, kw_only=True)
class Choice:
    """The plot of the action: a line for the chosen one, dots for those that were legal.

    Args:
        names: names of the actions, in order.
        fish: index into both, where there is an action of each of several fish.
        name: name of the plot.
    """

    names: tuple[str, ...]
    fish: int | None = None
    name: str = "action (line) among the legal ones (dots)"


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What is drawn of each flow of a task.

    Args:
        body_length: L, nodes.
        width: nodes along x.
        height: nodes along y.
        fields: fields of the flow; the first one is drawn, the others can be chosen instead.
        curves: bodies and lines, in drawing order.
        marks: points; one with a ``reach`` is the goal.
        arrows: forces, velocities.
        trails: paths of points.
        areas: rectangles.
        panels: plots next to the flow.
        note: further explanations, markdown.
    """

    body_length: float
    width: int
    height: int
    fields: tuple[Field, ...]
    curves: tuple[Curve, ...] = ()
    marks: tuple[Marks, ...] = ()
    arrows: tuple[Arrow, ...] = ()
    trails: tuple[Trail, ...] = ()
    areas: tuple[Area, ...] = ()
    panels: tuple[Panel | Choice, ...] = ()
    note: str = ""

    @property
    def field(self) -> Field:
        """The field that is drawn."""
        return self.fields[0]

    @property
    def goal(self) -> Marks | None:
        """The point to be reached, if there is one."""
        return next((marks for marks in self.marks if marks.reach > 0.0), None)

    @property
    def output_keys(self) -> set[str]:
        """Entries of the env's output that frames hold."""
        keys = set[str]()
        for panel in self.panels:
            if isinstance(panel, Choice):
                keys |= {"action", "action_mask"}
            elif panel.is_output:
                keys |= {series.key for series in panel.series}
        return keys

    def choose_field(self, key: str, *, limit: float | None = None) -> Self:
        """Return this scene with one of its fields drawn, its colours saturated at ``limit``.

        Raises:
            ValueError: for a field that the scene does not have.
        """
        chosen = [field for field in self.fields if field.key == key]
        if not chosen:
            known = [field.key for field in self.fields]
            raise ValueError(f"field = {key}: must be one of {', '.join(known)}")
        first = chosen[0] if limit is None else replace(chosen[0], limit=limit, saturated=None)
        others = [field for field in self.fields if field.key != key]
        return replace(self, fields=(first, *others))

    def extend(self, *, note: str = "", **parts: tuple[object, ...]) -> Self:
        """Return this scene with more of its parts, such as curves or marks, and a longer note."""
        longer = {name: getattr(self, name) + more for name, more in parts.items()}
        return replace(self, note="\n\n".join(filter(None, (self.note, note))), **longer)


@dataclass(frozen=True, kw_only=True)
class Frame:
    """One moment of one flow.

    Args:
        time: time in T; it never decreases from frame to frame.
        values: tensors by the keys of the scene; those that are missing are not drawn.
        begins: whether an episode begins here.
    """

    time: float
    values: Mapping[str, Tensor]
    begins: bool = False
