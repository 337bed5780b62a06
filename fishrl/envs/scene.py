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
    """A field over the whole grid, ``[Y, X]``."""

    key: str  #: key of its tensor in each frame
    name: str  #: name in the legend
    unit: str  #: unit of its values
    limit: float  #: value at which the colours saturate
    note: str = ""  #: meaning of the sign
    is_signed: bool = True  #: colours diverge around zero; otherwise they begin at zero
    #: share of the values beyond the limit that a film chooses; None for ``limit``
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
    """A curve ``[N, 2]``: closed, such as a body, or an open line, such as a midline."""

    key: str  #: key of its tensor
    colour: Colour  #: RGB colour of the line and the filling
    is_closed: bool = True  #: whether the last point joins the first
    is_filled: bool = True  #: whether a closed curve is filled
    order: float = 4.0  #: curves of higher order lie above
    name: str = ""  #: name next to a closed curve in films and pictures


@dataclass(frozen=True, kw_only=True)
class Marks:
    """Points ``[P, 2]`` or one point ``[2]``, in one colour or coloured by a value each."""

    key: str  #: key of their tensor
    radius: float  #: radius of a point, nodes
    colour: Colour = (120, 120, 120)  #: RGB colour of points without values
    name: str = ""  #: what the points are, or the name of their value, in the legend
    #: key of the values ``[P]``; they are drawn in diverging colours around zero
    value: str | None = None
    unit: str = ""  #: unit of the value
    limit: float = 1.0  #: value at which the colours saturate
    reach: float = 0.0  #: radius of a circle around each, nodes; 0 draws none


@dataclass(frozen=True, kw_only=True)
class Arrow:
    """A vector ``[2]`` drawn as an arrow, such as the force on a body; none if it is zero."""

    key: str  #: key of the vector
    at: str | tuple[float, float]  #: where it begins: a place, or the key of a point ``[2]``
    scale: float  #: nodes per unit of the vector
    colour: Colour = (0, 158, 115)  #: RGB colour of the arrow
    name: str = ""  #: label, followed by the vector's magnitude; films show named arrows alone
    unit: str = ""  #: unit of the magnitude


@dataclass(frozen=True, kw_only=True)
class Trail:
    """The path of a point ``[2]`` since its episode began."""

    key: str  #: key of the point
    colour: Colour = (90, 90, 90)  #: RGB colour of the line
    length_T: float = 30.0  #: how far back it reaches
    is_dotted: bool = False  #: whether a dot is at each place, instead of a line through them


@dataclass(frozen=True, kw_only=True)
class Area:
    """A fixed rectangle that the fish must not leave."""

    key: str  #: its name
    low: tuple[float, float]  #: corner (x, y) in nodes
    high: tuple[float, float]  #: the opposite corner
    colour: Colour = (200, 30, 40)  #: RGB colour of its border


@dataclass(frozen=True, kw_only=True)
class Series:
    """One line of a plot."""

    key: str  #: key of its tensor
    label: str  #: label in the legend
    column: int | None = None  #: index into the tensor; None if it is a single number
    is_rate: bool = False  #: draw its change per T since the previous frame instead
    colour: Colour | None = None  #: RGB colour of the line; by default the viewer chooses


@dataclass(frozen=True, kw_only=True)
class Panel:
    """A plot over time. NaN, and what a frame does not hold, is left out."""

    name: str  #: name of the plot, with its unit
    series: tuple[Series, ...]  #: its lines
    #: range of the vertical axis; by default the range of the values
    span: tuple[float, float] | None = None
    is_step: bool = False  #: values hold since the previous frame, rather than at an instant
    #: the keys are entries of the env's output rather than of ``views.read_scene``; the plot is
    #: left out where the env has no such entry
    is_output: bool = False
    #: draw sign(x) log2(1 + abs(x)), in which 1 is 1 and small values show next to large ones
    is_log: bool = False


@dataclass(frozen=True, kw_only=True)
class Choice:
    """The plot of the action: a line for the chosen one, dots for those that were legal."""

    names: tuple[str, ...]  #: names of the actions, in order
    fish: int | None = None  #: index into both, where there is an action of each of several fish
    name: str = "action (line) among the legal ones (dots)"  #: name of the plot


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What is drawn of each flow of a task."""

    body_length: float  #: L, nodes
    width: int  #: nodes along x
    height: int  #: nodes along y
    #: magnification of films and pictures; above 1 they follow the first of the curves
    zoom: float = 1.0
    title: str = ""  #: task and senses, and the policy if it is known
    #: fields of the flow; the first one is drawn, the others can be chosen instead
    fields: tuple[Field, ...]
    curves: tuple[Curve, ...] = ()  #: bodies and lines, in drawing order
    marks: tuple[Marks, ...] = ()  #: points; one with a ``reach`` is the goal
    arrows: tuple[Arrow, ...] = ()  #: forces, velocities
    trails: tuple[Trail, ...] = ()  #: paths of points
    areas: tuple[Area, ...] = ()  #: rectangles
    panels: tuple[Panel | Choice, ...] = ()  #: plots next to the flow
    note: str = ""  #: further explanations, markdown

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
class Ending:
    """How an episode ended."""

    words: str  #: such as "caught"
    is_success: bool  #: whether the task was accomplished


@dataclass(frozen=True, kw_only=True)
class Frame:
    """One moment of one flow."""

    time: float  #: time in T; it never decreases from frame to frame
    #: tensors by the keys of the scene; those that are missing are not drawn
    values: Mapping[str, Tensor]
    begins: bool = False  #: whether an episode begins here
    ending: Ending | None = None  #: in the last frame of an episode
