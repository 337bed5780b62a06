"""The main claim of each study, from its data; a test runs all ``check_*``."""

from hashlib import sha256
from math import isclose
from statistics import fmean, stdev

from studies.tables import STUDIES, read_data


def read(study: str, name: str, *keys: str) -> dict[tuple[str, ...], dict[str, str]]:
    """Return the rows of a table by the values of some columns."""
    return {tuple(row[key] for key in keys): row for row in read_data(study, name)}


def find_interval(row: dict[str, str], name: str) -> tuple[float, float]:
    """Return the ends of the interval of a value."""
    value, error = float(row[name]), float(row[f"{name} ±"])
    return value - error, value + error


def check_algorithms() -> None:
    """Discrete SAC leads DRQN alone significantly."""
    runs = read_data("algorithms", "runs")
    rates = [float(row["learned, %"]) for row in runs if row["run"].endswith("discrete_sac")]
    table = read("algorithms", "algorithms", "`algorithm`")
    assert len(rates) == 10 and len(runs) == 40
    assert isclose(fmean(rates), float(table["DiscreteSAC",]["success: mean, %"]), abs_tol=0.05)
    for row in read_data("algorithms", "differences"):
        low, _ = find_interval(row, "learning curve")
        assert (low > 0) == row["DiscreteSAC minus"].startswith("DRQN")


def check_c_start() -> None:
    """The best C-start goes farther than the published one with less work on every grid."""
    rows = read("c_start", "distances", "nodes per L", "strokes")
    gains = []
    for nodes in ("48", "96", "192"):
        best, published = rows[nodes, "best"], rows[nodes, "published"]
        gains.append(float(best["distance, L"]) / float(published["distance, L"]) - 1)
        assert float(best["work, ρ L⁴ / T²"]) < float(published["work, ρ L⁴ / T²"])
    assert [round(100 * gain) for gain in gains] == [13, 7, 6]


def check_changing_streams() -> None:
    """No classifier recognises 95 % of the changes within 2 periods."""
    for name in ("steady_classifier", "changing_classifier", "windows"):
        for row in read_data("changing_streams", name):
            is_true = "true label" in row.values()
            rate = row["recognised within 2 T, %"]
            assert is_true or not rate or float(rate) < 95


def check_continuous_control() -> None:
    """A free frequency leads to the Kármán gait at L = 64, in the stream of training."""
    own = read("continuous_control", "L64", "stream, L/T")["1.25 (trained)",]
    assert (own["lasted, %"], own["phase lock"]) == ("100", "0.96")
    coarse = read_data("continuous_control", "gait_sac")
    assert max(float(row["phase lock"]) for row in coarse) < 0.4


def check_drift_sweep() -> None:
    """No constant frequency holds station in all streams."""
    for row in read_data("drift_sweep", "fixed"):
        assert min(float(row[f"{speed} L/T"]) for speed in ("1", "1.25", "1.5")) < 20


def check_following() -> None:
    """Learned followers save work behind the leader alone, with a sharp skin less than by hand."""
    relative = "relative to `keep_place` alone"
    for skin in ("followers", "immersed"):
        rows = read("following", skin, "policy")
        behind, alone, by_hand = (
            find_interval(rows[name,], relative)
            for name in (
                "mean of 3 policies, behind the leader",
                "mean of 3 policies, alone",
                "`keep_place`, behind the leader",
            )
        )
        assert behind[1] < 1 < alone[1]
        assert (alone[0] > 1) == (skin == "immersed")
        assert (by_hand[1] < behind[0]) == (skin == "followers")


def check_gait_forces() -> None:
    """At the shedding frequency the phase decides the force."""
    rows = [row for row in read_data("gait_forces", "forces") if float(row["x, L"]) >= 1.6]
    forces = [[float(word) for word in row["1 f, by phase"].split(" to ")] for row in rows]
    assert (min(map(min, forces)), max(map(max, forces))) == (-0.121, 0.031)
    others = [[float(row[f"{ratio} f"]) for ratio in ("0.5", "0.85", "1.15")] for row in rows]
    spread = [max(each) - min(each) for each in others]
    assert all(high - low > s for (low, high), s in zip(forces, spread, strict=True))


def check_karman_gait() -> None:
    """301 of 306 episodes last with both modules; with a sharp skin fewer do without."""
    counts = dict.fromkeys(("both modules", "ablation"), 0)
    for row in read_data("karman_gait", "sharp_64"):
        counts[row["policy"]] += round(int(row["episodes"]) * float(row["lasted, %"]) / 100)
    assert counts == {"both modules": 36, "ablation": 23}
    counts = dict.fromkeys(counts, 0)
    for row in read_data("karman_gait", "sharp_100"):
        counts[row["policy"]] += round(int(row["episodes"]) * float(row["lasted, %"]) / 100)
    assert counts == {"both modules": 9, "ablation": 5}
    rows = [row for row in read_data("karman_gait", "station") if row["policy"] == "both modules"]
    lasted = [round(int(row["episodes"]) * float(row["lasted, %"]) / 100) for row in rows]
    assert (sum(lasted), sum(int(row["episodes"]) for row in rows)) == (301, 306)


def check_lateral_line() -> None:
    """The accuracy of the paper's classifier is inflated by leakage."""
    own, paper = read_data("lateral_line", "classifiers")
    gaps = [float(r["fitted, %"]) - float(r["held-out episodes, %"]) for r in (own, paper)]
    assert gaps[0] < 3 and gaps[1] > 30


def check_peers() -> None:
    """The flow with walls runs at 70 % of the speed of lbmpy's fastest kernel."""
    speeds = read("peers", "speeds", "code", "case", "what")
    shape = "1 × 1000 × 500"
    fastest = speeds["lbmpy", f"{shape}, in place (esoteric twist), 2 threads", "kernel"]
    assert int(fastest["MLUPS"]) == max(int(row["MLUPS"]) for row in speeds.values())
    ratios = read("peers", "ratios", "fishrl / other code")
    ratio = ratios["flow and walls / lbmpy's in-place kernel",]
    assert (ratio["measured, ×"], ratio["result"]) == ("0.70", "MISSED")
    bulk = speeds["fishrl", f"{shape}, 2 threads", "kernel"]
    assert isclose(int(bulk["MLUPS"]) / int(fastest["MLUPS"]), 0.86, abs_tol=0.01)


def check_predation() -> None:
    """Three seeds of predation catch 91 %; on drawn paths memory adds less than seeds differ."""
    rates = [float(row["learned, %"]) for row in read_data("predation", "small")]
    assert len(rates) == 3 and round(fmean(rates)) == 91
    caught: dict[str, list[float]] = {"4": [], "1": []}
    for row in read_data("predation", "memory"):
        caught[row["observations that the policy sees"]].append(float(row["captured of 96, %"]))
    assert [(len(each), round(fmean(each))) for each in caught.values()] == [(5, 75), (5, 69)]
    assert max(caught["4"]) - min(caught["4"]) > 2 * (fmean(caught["4"]) - fmean(caught["1"]))


def check_four_arms() -> None:
    """Each blind fish with a lateral line stays longer than each without; a seeing one does not."""
    name, stays = "64 to 74 thousand, T", dict[str, list[float]]()
    for row in read_data("four_arms", "arms"):
        stays.setdefault(row["observed besides own motion"], []).append(float(row[name] or "nan"))
    assert all(len(stays[arm]) == 5 for arm in list(stays)[:4])
    assert min(stays["lateral line"]) > max(stays["–"])
    see, all_senses = stays["place, drift, heading"], stays["place, drift, heading, lateral line"]
    assert abs(fmean(all_senses) - fmean(see)) < 1.2 and min(see) > max(stays["lateral line"])
    greedy = read("four_arms", "behaviour", "policy", "condition")
    blind, without = (greedy[arm, "as trained"] for arm in ("lateral line", "–"))
    assert find_interval(blind, "duration, T")[0] > 1.5 * find_interval(without, "duration, T")[1]
    taught = read("four_arms", "recognition", "observed")
    own, label, line = (
        float(taught[f"own motion{more}",]["new: duration, T"])
        for more in ("", ", label", ", lateral line")
    )
    assert abs(label - own) < 0.1 * own and line > 2 * max(own, label)


def check_reproduction() -> None:
    """Both modules survive as the paper's do, and the ablation longer."""
    for scale in ("small", "half"):
        rows = read("reproduction", scale, "quantity, in the flows I, II, III")
        both, none = rows["survival with both, T",], rows["survival without modules, T",]
        assert min(map(float, both["ours"].split(", "))) > 89
        ours, papers = (list(map(float, none[name].split(", "))) for name in ("ours", "paper"))
        assert all(a > b for a, b in zip(ours, papers, strict=True))


def check_turning_patch() -> None:
    """Patches of any size scatter about the uniform grid as that does between starts."""
    rows = read_data("turning_patch", "turns")
    scatter = stdev(float(row["power, uniform, %"]) for row in rows)
    for size in ("1.5", "2.0", "2.5"):
        found = [float(row[f"power, {size} L, %"]) for row in rows]
        assert abs(fmean(found)) < scatter / len(found) ** 0.5  # its standard error
        assert 0.5 * scatter < stdev(found) < 2.0 * scatter


def check_robustness() -> None:
    """No policy differs from the PID controller by more than the scatter."""
    rows = [row for row in read_data("robustness", "conditions") if row["policy"] != "pid"]
    name = "beyond pid, T"
    assert len(rows) == 30
    assert all(float(row[f"{name} low"]) <= 0 <= float(row[f"{name} high"]) for row in rows)


def check_steering() -> None:
    """The file in the package is the one that was exported, of a policy of predation."""
    layers = read_data("steering", "layers")
    assert (layers[0]["inputs"], layers[-1]["outputs"]) == ("16", "3")
    content = (STUDIES.parent / "fishrl" / "envs" / "steering.pt").read_bytes()
    page = (STUDIES / "steering" / "README.md").read_text(encoding="utf-8")
    assert sha256(content).hexdigest() in page


def check_sharp_skin() -> None:
    """No collision changes the speed by 2 %; in a stream central moments keep the viscosity."""
    own, *others = read_data("sharp_skin", "collision")
    for name in ("speed, L = 32", "speed, L = 50"):
        assert all(isclose(float(row[name]), float(own[name]), rel_tol=0.02) for row in others)
    for row in read_data("sharp_skin", "viscosity"):
        change = float(row["0.1"]) - float(row["frame 0"])
        assert (abs(change) < 0.2) == row["collision"].startswith("central")
