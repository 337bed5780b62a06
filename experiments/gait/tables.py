"""The Kármán gait in tables, beside the paper's numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

#: Zhang et al. 2023, Tables 2 to 4 and text: of conditions I, II and III.
PAPER = {
    "survival without": (6.54, 39.80, 6.13),
    "survival with": (100.0, 100.0, 100.0),
    "in_gait": (0.955, 0.870, 0.930),
    "angle_max": (14.3, 15.0, 11.7),
    "work_ratio": (7577.94 / 1526.73, 14682.95 / 2145.74, 51520.26 / 3057.03),
}
#: Of every fish and flow: heading, entry of ``diagnose``, format.
COLUMNS = (
    ("survival, T", "survival_T", ".1f"),
    ("lasted", "survivors", ".0%"),
    ("told right", "named_right", ".1%"),
    ("x, L", "x_mean", ".2f"),
    ("beat / shedding", "frequency_over_shedding", ".2f"),
    ("in street", "in_street", ".0%"),
    ("in gait", "in_gait", ".0%"),
    ("up", "accelerations", ".0%"),
    ("down", "decelerations", ".0%"),
    ("angle mean, °", "angle_mean", ".1f"),
    ("max, °", "angle_max", ".1f"),
    ("sway, L", "sway", ".3f"),
    ("phase lock", "phase_lock", ".2f"),
    ("work per T", "work", ".3f"),
    ("pushing", "positive_work", ".3f"),
    ("lateral", "lateral_work", ".3f"),
)

Results = Mapping[str, Sequence[Mapping[str, float]]]


def write_table(results: Results, speeds: Sequence[float]) -> str:
    """Return a Markdown table: a row per fish and flow.

    Args:
        results: of each arm, per flow, as ``diagnose`` or ``combine_seeds`` returns.
        speeds: of the flows, L / T.
    """
    heads = ["fish", "stream, L/T", "episodes", *(head for head, _, _ in COLUMNS)]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for name, flows in results.items():
        for speed, result in zip(speeds, flows, strict=True):
            cells = [name, f"{speed:g}", f"{result['episodes']:.0f}"]
            for _, key, form in COLUMNS:
                cell = _show(result.get(key, float("nan")), form)
                if key == "survival_T" and result["survival_error_T"] == result["survival_error_T"]:
                    cell += f" ± {result['survival_error_T']:.1f}"
                cells.append(cell)
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def write_ends(results: Results, speeds: Sequence[float]) -> str:
    """Return a Markdown table of where episodes ended."""
    lines = [
        "| fish | stream, L/T | lasted | at the disc | swept away | aside | diverged |",
        "|---" * 7 + "|",
    ]
    for name, flows in results.items():
        for speed, result in zip(speeds, flows, strict=True):
            shares = [
                _show(result[key], ".0%")
                for key in ("survivors", "ended_near", "ended_far", "ended_aside")
            ]
            cells = [name, f"{speed:g}", *shares, f"{result['diverged']:.0f}"]
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def write_work_table(
    in_wake: Sequence[Mapping[str, float]],
    free: Sequence[Mapping[str, float]],
    speeds: Sequence[float],
) -> str:
    """Return a Markdown table: work per T in the wake and in the free stream, and their ratio."""
    lines = [
        "| stream, L/T | work, wake | free | ratio | saved | pushing: ratio "
        "| lateral (paper's form), wake | free | ratio | paper's ratio |",
        "|---" * 10 + "|",
    ]
    for number, (speed, wake, still) in enumerate(zip(speeds, in_wake, free, strict=True)):
        ratio = {
            name: still[name] / wake[name] if min(still[name], wake[name]) > 0.0 else float("nan")
            for name in ("work", "positive_work", "lateral_work")
        }
        known = PAPER["work_ratio"]
        paper = f"{known[number]:.2f}" if len(speeds) == len(known) else "–"
        cells = [
            f"{speed:g}", f"{wake['work']:.3f}", f"{still['work']:.2f}",
            _show(ratio["work"], ".1f"),
            _show(1.0 - 1.0 / ratio["work"], ".1%"), _show(ratio["positive_work"], ".1f"),
            f"{wake['lateral_work']:.3f}", f"{still['lateral_work']:.2f}",
            _show(ratio["lateral_work"], ".1f"), paper,
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _show(value: float, form: str) -> str:
    return "–" if value != value else format(value, form)
