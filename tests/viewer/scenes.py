"""A scene with everything in it, and frames of it that move."""

import torch

from fishrl.envs.scene import (
    Area,
    Arrow,
    Choice,
    Curve,
    Field,
    Frame,
    Marks,
    Panel,
    Scene,
    Series,
    Trail,
)

WIDTH, HEIGHT, LENGTH = 120, 60, 20.0


def make_scene(*, limit: float = 10.0) -> Scene:
    reward = (Series(key="reward", label="reward"),)
    labels = tuple(Series(key="labels", label=f"flow {i}", column=i) for i in range(2))
    return Scene(
        body_length=LENGTH,
        width=WIDTH,
        height=HEIGHT,
        fields=(
            Field(key="vorticity", name="vorticity", unit="1/T", limit=limit),
            Field(key="speed", name="speed", unit="L/T", limit=2.0, is_signed=False),
        ),
        curves=(
            Curve(key="fish", colour=(32, 37, 43)),
            Curve(key="midline", colour=(240, 240, 240), is_closed=False, order=5.0),
        ),
        marks=(
            Marks(key="food", radius=2.0, colour=(242, 177, 52), reach=6.0),
            Marks(key="neuromasts", radius=1.0, value="felt", name="pressure", unit="ρ"),
        ),
        arrows=(Arrow(key="force", at="centre", scale=40.0),),
        trails=(Trail(key="head", length_T=1.0),),
        areas=(Area(key="danger_area", low=(10.0, 10.0), high=(90.0, 50.0)),),
        panels=(
            Panel(name="reward", series=reward, is_step=True, is_log=True),
            Choice(names=("left", "keep", "right")),
            Panel(name="class probabilities", series=labels, span=(-0.05, 1.05)),
            Panel(name="power [x/T]", series=(Series(key="work", label="power", is_rate=True),)),
            Panel(name="angle [°]", series=(Series(key="angle", label="angle"),)),
        ),
        note="A note.",
    )


def make_frame(number: int, *, begins: bool = False, time: float | None = None) -> Frame:
    """Return one of four frames per T; the fish swims to the left through stripes."""
    now = number / 4.0 if time is None else time
    turn = torch.linspace(0.0, 2.0 * torch.pi, 41)[:-1]
    x = 70.0 - 4.0 * now + 0.5 * LENGTH * (1.0 - turn.cos())
    outline = torch.stack((x, 30.0 + 3.0 * turn.sin()), -1)
    stripes = 12.0 * torch.sin(torch.arange(WIDTH) / 8.0 - now).expand(HEIGHT, WIDTH)
    return Frame(
        time=now,
        begins=begins,
        values={
            "vorticity": stripes.half(),
            "speed": stripes.abs().half() / 6.0,
            "centre": outline.mean(0),
            "force": torch.tensor([0.25, 0.5]),
            "fish": outline,
            "midline": 0.5 * (outline[:21] + outline[-torch.arange(21) % 40]),
            "head": outline[0],
            "food": torch.tensor([30.0, 20.0 + now]),
            "neuromasts": outline[[5, 35]],
            "felt": torch.tensor([1.0, -1.0]),
            "reward": torch.tensor(1.0 - 2.0 * (number % 2)),
            "action": torch.tensor(number % 3),
            "action_mask": torch.tensor([number > 0, True, True]),
            "labels": torch.tensor([0.25, 0.75]),
            "work": torch.tensor(2.0 * now),
            "angle": torch.tensor(torch.nan if number == 1 else 5.0 * now),
        },
    )
