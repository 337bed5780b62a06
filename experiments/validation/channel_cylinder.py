"""Cylinder in a channel: the benchmark of Schäfer & Turek, steady and shedding."""

from collections.abc import Mapping, Sequence

import torch
from matplotlib.figure import Figure
from torch import Tensor

from experiments.figures import COLOURS
from experiments.validation.case import Case, Check, Job, Result, Results
from experiments.validation.convergence import check_finest, tidy
from experiments.validation.wake import (
    draw_vorticity,
    make_even,
    record_force,
    take_vorticity,
)
from fishrl.physics import (
    Cylinder,
    Fixed,
    FlowConfig,
    InPlaceSolver,
    compute_coefficient,
    compute_pressure,
    compute_spectral_frequency,
    measure_cycles,
)
from fishrl.physics.boundaries import Boundaries, NonEquilibrium, NoSlip, OpenEdge, Profile
from fishrl.physics.collision import compute_equilibrium
from fishrl.physics.immersed_boundary import DirectSolve

LENGTH_D, HEIGHT_D, PLACE_D, VIEW_D = 22.0, 4.1, 2.0, 10.0
MEAN = 2.0 / 3.0  # mean over peak speed of a parabola
SPEED = 0.05
MEAN_SPEED = {20: 0.2, 100: 1.0}  # of the benchmark, m/s, which gives its pressures
SIZES = (20, 40, 60)
VARIANTS: Mapping[str, dict[str, float | bool]] = {
    "U = 0.1": {"speed": 0.1},
    "markers on the outline": {"inset": 0.0},
    "pinned outlet": {"is_pinned": True},
}
ORGAN_PIPE = (
    "between an inflow that pins velocity and an outflow that pins density sound runs to and fro "
    "like in an organ pipe; its tones lie near the drag's and shake the cylinder."
)
FINER = "the interval of 1996 does not hold what finer runs found since, 0.9866."
INTERVALS = "Schäfer & Turek 1996"
NABH = "Nabh 1998, spectral"
FEATFLOW = "FeatFlow, level 6"
TRAVELS = {20: 60.0, 100: 80.0}  # by Reynolds number


def run_channel(
    *,
    diameter: int,
    reynolds: int,
    speed: float = SPEED,
    inset: float = 0.45,
    is_pinned: bool = False,
) -> Result:
    """Run the benchmark from a developed channel flow.

    Args:
        diameter: D in nodes, a multiple of 10, so that the channel is 4.1 D high exactly.
        reynolds: U_mean D / nu.
        speed: peak speed of the inflow, nodes per step.
        inset: of the markers, nodes.
        is_pinned: an outlet with pinned density instead of one that lets sound out.

    Returns:
        Coefficients, pressure drop in the benchmark's unit, Strouhal number and the lift over time.
    """
    mean = MEAN * speed
    nu = mean * diameter / reynolds
    is_shedding = reynolds == 100
    kick = (
        Fixed(kick_speed=0.3 * mean, kick_steps=round(diameter / mean)) if is_shedding else Fixed()
    )
    outlet = NonEquilibrium(density=1.0) if is_pinned else OpenEdge(profile=Profile.PARABOLA)
    config = FlowConfig(
        width=round(LENGTH_D * diameter) + 1,
        height=round(HEIGHT_D * diameter),
        tau=3.0 * nu + 0.5,
        stream_speed=speed,
        bodies=(Cylinder(diameter=diameter, inset=inset, motion=kick),),
        boundaries=Boundaries(
            left=NonEquilibrium(velocity=(1.0, 0.0), profile=Profile.PARABOLA),
            right=outlet,
            bottom=NoSlip(),
            top=NoSlip(),
        ),
        force_solve=DirectSolve(regularisation=0.0),
    )
    solver = InPlaceSolver(config=config, num_envs=1, num_workers=0)
    x, y = PLACE_D * diameter, PLACE_D * diameter - 0.5  # the walls stand half a node outside
    solver.reset_(torch.ones(1, dtype=torch.bool), torch.tensor([[x, y]]).double())
    solver.set_populations_(_develop_channel(config, speed))
    interval = make_even(diameter / mean / 60.0)
    num_steps = round(0.5 * TRAVELS[reynolds] * diameter / mean)
    record_force(solver, num_steps, interval)
    force = record_force(solver, num_steps, interval)
    rho, _ = solver.macroscopic()
    density = float(rho[0, :, 1].double().mean())
    scale = {"length": float(diameter), "speed": mean, "rho": density}
    drag, lift = compute_coefficient(force, **scale).unbind(-1)
    drop = _measure_pressure_drop(rho[0], x, y, diameter)
    window = (0, round(VIEW_D * diameter), 0, config.height)
    result: Result = {
        "inflow_density": density,
        "pressure_drop": MEAN_SPEED[reynolds] ** 2 * drop / (density * mean**2),
        "lift_series": [round(v, 5) for v in lift[-300:].tolist()],
        "drag_series": [round(v, 5) for v in drag[-300:].tolist()],
        "interval": interval * mean / diameter,
        "vorticity": take_vorticity(solver, window, scale=diameter / mean),
    }
    if not is_shedding:
        late = len(drag) // 4
        return result | {
            "drag": float(drag[-late:].mean()),
            "lift": float(lift[-late:].mean()),
            "drift": float(drag[-late:].max() - drag[-late:].min()),
        }
    beat = measure_cycles(lift, result["interval"])
    swing = measure_cycles(drag, result["interval"], clock=lift)
    return result | {
        "strouhal": beat.frequency,
        "spectral": compute_spectral_frequency(lift, result["interval"]),
        "drag_max": swing.high,
        "drag_min": swing.low,
        "lift_max": beat.high,
        "lift_min": beat.low,
        "num_cycles": beat.num_cycles,
    }


def _develop_channel(config: FlowConfig, speed: float) -> Tensor:
    """Return populations of Poiseuille flow with its pressure, so that the start makes no sound."""
    y = (torch.arange(config.height, dtype=torch.float64) + 0.5) / config.height
    x = torch.arange(config.width, dtype=torch.float64)
    slope = 3.0 * 8.0 * config.nu * speed / config.height**2
    shape = (1, config.height, config.width)
    u = (4.0 * speed * y * (1.0 - y))[None, :, None].expand(shape)
    rho = (slope * (config.width - 1 - x))[None, None].expand(shape)
    return torch.stack(compute_equilibrium(rho, u, 0.0 * u), 1).float()


def _measure_pressure_drop(rho: Tensor, x: float, y: float, diameter: int) -> float:
    """Return p in front of the cylinder less p behind it, on its surface.

    The kernel smears the pressure there: a parabola through the nodes 2, 3 and 4 outside gives it.
    """
    row = compute_pressure(rho[int(y) : int(y) + 2].double()).mean(0)  # y lies between two rows
    front, back = round(x - 0.5 * diameter), round(x + 0.5 * diameter)
    ends = [
        6.0 * row[at + 2 * step] - 8.0 * row[at + 3 * step] + 3.0 * row[at + 4 * step]
        for at, step in ((front, -1), (back, 1))
    ]
    return float(ends[0] - ends[1])


def _label(reynolds: int, size: int, variant: str = "") -> str:
    return f"Re = {reynolds}, D = {size}" + (f", {variant}" if variant else "")


class ChannelCylinder(Case):
    """Cylinder between two walls at Re 20 (2D-1) and Re 100 (2D-2)."""

    name = "channel-cylinder"
    title = "Cylinder in a channel (Schäfer–Turek 2D-1 and 2D-2)"
    source = (
        "Schäfer & Turek 1996, NNFM 52, 547 (intervals); Nabh 1998 and the FeatFlow group's finest "
        "runs (numbers), all as others quote them"
    )
    setup = (
        "Channel 22 D long and 4.1 D high between half-way bounce-back walls; the cylinder stands "
        "2 D behind a parabolic inflow, 2 D above the lower wall. Re and coefficients by the mean "
        "speed, 2/3 of the peak U = 0.05, and by the density at the inflow. The outflow lets plane "
        "sound waves out. Markers lie 0.45 nodes inside the outline, no slip is solved exactly. "
        "The start is Poiseuille flow with its pressure, at Re = 100 with a kick of the cylinder; "
        "60 and 80 D / U_mean, of which the second half is measured, over whole periods. The "
        "pressure on the surface is a parabola through the nodes 2, 3 and 4 outside it."
    )

    def jobs(self, *, quick: bool) -> Sequence[Job]:
        """Return a run for each Reynolds number and size, and variants of the smallest."""
        runs = [(re, size, "") for re in TRAVELS for size in (SIZES[:1] if quick else SIZES)]
        if not quick:
            runs += [(re, SIZES[0], variant) for re in TRAVELS for variant in VARIANTS]
        return [
            Job(
                label=_label(re, size, variant),
                function=run_channel,
                arguments={"diameter": size, "reynolds": re} | VARIANTS.get(variant, {}),
                cost=90.0 * TRAVELS[re] * size**3 / (MEAN * SPEED),
            )
            for re, size, variant in runs
        ]

    def judge(self, results: Results) -> Sequence[Check]:
        """Judge drag, lift and Strouhal number; show the rest."""
        steady, shedding = (
            {n: results[_label(re, n)] for n in SIZES if _label(re, n) in results} for re in TRAVELS
        )

        def pick(runs: Mapping[int, Result], key: str) -> dict[int, float]:
            return {n: run[key] for n, run in runs.items()}

        height = {n: run["lift_max"] - run["lift_min"] for n, run in shedding.items()}
        spread = (3.22, 3.24), (0.99, 1.01), (0.295, 0.305)
        drag, lift, beat = (pick(shedding, key) for key in ("drag_max", "lift_max", "strouhal"))
        checks = [
            check_finest("C_d, Re = 20", pick(steady, "drag"), 5.57953523, NABH, 0.015),
            check_finest("C_l, Re = 20", pick(steady, "lift"), 0.01061895, NABH),
            check_finest("Δp [Pa], Re = 20", pick(steady, "pressure_drop"), 0.11752017, NABH),
            check_finest("C_d,max, Re = 100", drag, spread[0], INTERVALS, 0.03),
            *(
                [check_finest("C_l,max, Re = 100", lift, spread[1], INTERVALS, 0.03, FINER)]
                if max(lift) > SIZES[0]  # the lift of a quick run is known to be 9 % low
                else []
            ),
            check_finest("St, Re = 100", beat, spread[2], INTERVALS, 0.015),
            check_finest("C_d,max, Re = 100, again", drag, 3.227393, FEATFLOW),
            check_finest("C_l,max, Re = 100, again", lift, 0.986571, FEATFLOW),
            check_finest("C_l, crest to trough, Re = 100", height, 2.007871, FEATFLOW),
            check_finest("St, Re = 100, again", beat, 0.30184, FEATFLOW),
        ]
        swing = {
            label: r["drag_max"] - r["drag_min"] for label, r in results.items() if "drag_max" in r
        }
        for name, reference, source, values, reynolds in (
            ("C_d, Re = 20", 5.57953523, NABH, _pick_all(results, "drag"), 20),
            ("C_d,max, Re = 100", 3.227393, FEATFLOW, _pick_all(results, "drag_max"), 100),
            ("C_d, crest to trough, Re = 100", 0.063129, FEATFLOW, swing, 100),
        ):
            names = {"as judged": "", **{v: v for v in VARIANTS}}
            row = {
                k: values[at]
                for k, v in names.items()
                if (at := _label(reynolds, SIZES[0], v)) in values
            }
            if len(row) > 1:
                checks.append(
                    Check(
                        quantity=f"{name}, D = {SIZES[0]}", ours=row["as judged"], source=source,
                        reference=reference, resolution=f"D = {SIZES[0]}", refinement=row,
                        note=ORGAN_PIPE if "trough" in name else "",
                    )
                )  # fmt: skip
        return checks

    def draw(self, results: Results) -> Figure:
        """Draw the wake, the forces over time and the errors against resolution."""
        shedding = {n: results[at] for n in SIZES if (at := _label(100, n)) in results}
        steady = {n: results[at] for n in SIZES if (at := _label(20, n)) in results}
        run = shedding[max(shedding)]
        figure = Figure(figsize=(7.6, 6.2), layout="constrained")
        grid = figure.add_gridspec(2, 2, height_ratios=(1.15, 1.0))
        axes = figure.add_subplot(grid[0, :])
        reach = (-PLACE_D, VIEW_D - PLACE_D, -PLACE_D, HEIGHT_D - PLACE_D)
        draw_vorticity(axes, run["vorticity"], reach, limit=6.0)
        axes.set_title(f"Re = 100, D = {max(shedding)} nodes", loc="left")
        axes = figure.add_subplot(grid[1, 0])
        time = [i * run["interval"] for i in range(len(run["lift_series"]))]
        axes.plot(time, run["lift_series"], color=COLOURS[0], label="C_l")
        axes.plot(time, [d - 3.0 for d in run["drag_series"]], color=COLOURS[1], label="C_d − 3")
        for value in (0.986571, -1.021288, 0.227393, 0.164264):
            axes.axhline(value, color="#777777", linestyle=":", linewidth=0.9)
        axes.set(xlabel="time  [D / U_mean]", ylabel="force coefficient")
        axes.set_title("Re = 100; dotted: extremes by FeatFlow", loc="left")
        axes.legend(fontsize=9)
        tidy(axes)
        axes = figure.add_subplot(grid[1, 1])
        for name, runs, key, reference in (
            ("C_d, Re = 20", steady, "drag", 5.57953523),
            ("C_d,max, Re = 100", shedding, "drag_max", 3.227393),
            ("C_l,max, Re = 100", shedding, "lift_max", 0.986571),
            ("St, Re = 100", shedding, "strouhal", 0.30184),
        ):
            errors = [100.0 * (result[key] / reference - 1.0) for result in runs.values()]
            axes.plot(list(runs), errors, marker="o", markerfacecolor="none", label=name)
        axes.axhline(0.0, color="#777777", linewidth=0.9)
        axes.set(xlabel="diameter D  [nodes]", ylabel="error  [%]", xticks=list(SIZES))
        axes.set_title("against Nabh and FeatFlow", loc="left")
        axes.legend(fontsize=8)
        tidy(axes)
        return figure


def _pick_all(results: Results, key: str) -> dict[str, float]:
    return {label: result[key] for label, result in results.items() if key in result}
