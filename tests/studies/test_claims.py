"""The main claim of each frozen study, from its data."""

from statistics import fmean

import pytest

from studies.tables import read_data


def read(study: str, name: str, *keys: str) -> dict[tuple[str, ...], dict[str, str]]:
    """Return the rows of a table by the values of some columns."""
    return {tuple(row[key] for key in keys): row for row in read_data(study, name)}


def find_interval(row: dict[str, str], name: str) -> tuple[float, float]:
    value, error = float(row[name]), float(row[f"{name} ±"])
    return value - error, value + error


def test_sac_leads_drqn_alone_significantly() -> None:
    runs = read_data("algorithms", "runs")
    rates = [float(row["learned, %"]) for row in runs if row["run"].endswith("discrete_sac")]
    table = read("algorithms", "algorithms", "`algorithm`")
    assert len(rates) == 10 and len(runs) == 40
    assert fmean(rates) == pytest.approx(float(table["DiscreteSAC",]["success: mean, %"]), abs=0.05)
    for row in read_data("algorithms", "differences"):
        low, _ = find_interval(row, "learning curve")
        assert (low > 0) == row["DiscreteSAC minus"].startswith("DRQN")


def test_best_c_start_goes_farther_with_less_work_on_every_grid() -> None:
    rows = read("c_start", "distances", "nodes per L", "strokes")
    gains = []
    for nodes in ("48", "96", "192"):
        best, published = rows[nodes, "best"], rows[nodes, "published"]
        gains.append(float(best["distance, L"]) / float(published["distance, L"]) - 1)
        assert float(best["work, ρ L⁴ / T²"]) < float(published["work, ρ L⁴ / T²"])
    assert [round(100 * gain) for gain in gains] == [13, 7, 6]


def test_no_classifier_recognises_95_percent_of_the_changes_within_2_periods() -> None:
    for name in ("steady_classifier", "changing_classifier", "windows"):
        for row in read_data("changing_streams", name):
            is_true = "true label" in row.values()
            rate = row["recognised within 2 T, %"]
            assert is_true or not rate or float(rate) < 95


def test_free_frequency_leads_to_the_karman_gait_in_the_stream_of_training_at_L64() -> None:
    own = read("continuous_control", "L64", "stream, L/T")["1.25 (trained)",]
    assert (own["lasted, %"], own["phase lock"]) == ("100", "0.96")
    coarse = read_data("continuous_control", "gait_sac")
    assert max(float(row["phase lock"]) for row in coarse) < 0.4


def test_no_constant_frequency_holds_station_in_all_streams() -> None:
    for row in read_data("drift_sweep", "fixed"):
        assert min(float(row[f"{speed} L/T"]) for speed in ("1", "1.25", "1.5")) < 20


def test_learned_followers_save_work_behind_the_leader_alone() -> None:
    rows = read("following", "followers", "policy")
    relative = "relative to `keep_place` alone"
    behind, alone = (
        rows[f"mean of 3 policies, {where}",] for where in ("behind the leader", "alone")
    )
    assert find_interval(behind, relative)[1] < 1 < find_interval(alone, relative)[0]


def test_phase_decides_the_force_at_the_shedding_frequency() -> None:
    rows = [row for row in read_data("gait_forces", "forces") if float(row["x, L"]) >= 1.6]
    forces = [[float(word) for word in row["1 f, by phase"].split(" to ")] for row in rows]
    assert (min(map(min, forces)), max(map(max, forces))) == (-0.121, 0.031)
    others = [[float(row[f"{ratio} f"]) for ratio in ("0.5", "0.85", "1.15")] for row in rows]
    spread = [max(each) - min(each) for each in others]
    assert all(high - low > s for (low, high), s in zip(forces, spread, strict=True))


def test_301_of_306_episodes_last_with_both_modules() -> None:
    rows = [row for row in read_data("karman_gait", "station") if row["policy"] == "both modules"]
    lasted = [round(int(row["episodes"]) * float(row["lasted, %"]) / 100) for row in rows]
    assert (sum(lasted), sum(int(row["episodes"]) for row in rows)) == (301, 306)


def test_accuracy_of_the_papers_classifier_is_inflated_by_leakage() -> None:
    own, paper = read_data("lateral_line", "classifiers")
    gaps = [float(r["fitted, %"]) - float(r["held-out episodes, %"]) for r in (own, paper)]
    assert gaps[0] < 3 and gaps[1] > 30


def test_flow_with_walls_runs_at_70_percent_of_lbmpys_fastest_kernel() -> None:
    speeds = read("peers", "speeds", "code", "case", "what")
    shape = "1 × 1000 × 500"
    fastest = speeds["lbmpy", f"{shape}, in place (esoteric twist), 2 threads", "kernel"]
    assert int(fastest["MLUPS"]) == max(int(row["MLUPS"]) for row in speeds.values())
    ratio = read("peers", "ratios", "fishrl / other code")[
        "flow and walls / lbmpy's in-place kernel",
    ]
    assert (ratio["measured, ×"], ratio["result"]) == ("0.70", "MISSED")
    bulk = speeds["fishrl", f"{shape}, 2 threads", "kernel"]
    assert int(bulk["MLUPS"]) / int(fastest["MLUPS"]) == pytest.approx(0.86, abs=0.01)


def test_three_seeds_of_predation_catch_91_percent() -> None:
    rates = [float(row["learned, %"]) for row in read_data("predation", "small")]
    assert len(rates) == 3 and round(fmean(rates)) == 91


def test_both_modules_survive_as_the_papers_and_the_ablation_longer() -> None:
    for scale in ("small", "half"):
        rows = read("reproduction", scale, "quantity, in the flows I, II, III")
        both, none = rows["survival with both, T",], rows["survival without modules, T",]
        assert min(map(float, both["ours"].split(", "))) > 89
        ours, papers = (list(map(float, none[name].split(", "))) for name in ("ours", "paper"))
        assert all(a > b for a, b in zip(ours, papers, strict=True))


def test_no_policy_differs_from_the_pid_controller_by_more_than_the_scatter() -> None:
    rows = [row for row in read_data("robustness", "conditions") if row["policy"] != "pid"]
    name = "beyond pid, T"
    assert len(rows) == 30
    assert all(float(row[f"{name} low"]) <= 0 <= float(row[f"{name} high"]) for row in rows)
