"""Run the peers' benchmark with trackrs in it and write RESULTS.md: `make bench BENCH=path/of/the/peers`.

Everything is run on one core, the limits of the machine (limits.py) just before and just after. What counts is the
ratio of two medians of one run; the spread of the repetitions stands beside it.
"""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
PLAIN = {"us", "ms", "us_per_step", "us_per_step_filter+smooth"}  # other limits are of other algorithms
FILES = {
    "w01_kf.py": ["W1", "W2", "W3c"],
    "w03_nonlinear.py": ["W3", "W3b"],
    "w04_gating.py": ["W4full", "W4gated"],
    "w05_clustering.py": ["W5lof", "W5dbscan", "W5kmeans", "W5dpeaks"],
    "w06_jpda.py": ["W6"],
    "w07_phd.py": ["W7"],
    "crossing_scan.py": ["W5two", "W5dist", "W7ext"],
    "w08_metrics_assign.py": ["W8ospa", "W8gospa", "W9"],
    "w10_mtt.py": ["W10kf"],
    "sparse_assignment.py": ["W9sparse"],
}


def measure(folder: Path) -> list[dict]:
    """Return the records of all files, the limits first and last."""
    out = folder / "bench.jsonl"
    paths = [str(HERE), str(folder)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "BENCH_OUT": str(out)}
    pinned = ["taskset", "-c", "0"] if shutil.which("taskset") else []
    commands = [["limits.py"], *([name, "--workload", *ids] for name, ids in FILES.items()), ["limits.py"]]
    for command in commands:
        print("benchmark:", *command, flush=True)
        subprocess.run(
            [*pinned, sys.executable, *command], cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL
        )
    return [json.loads(line) for line in out.read_text().splitlines()]


def table(records: list[dict]) -> list[str]:
    """Return the lines of one table per workload and size, the fastest first."""
    lines = []
    wanted = {workload for ids in FILES.values() for workload in ids}
    keys = dict.fromkeys((r["workload"], str(r["n"])) for r in records if r["workload"] in wanted and "median" in r)
    for workload, size in keys:
        rows = [r for r in records if (r["workload"], str(r["n"])) == (workload, size) and "median" in r]
        limits = [
            r
            for r in rows
            if r["peer"] == "LIMIT" and r["metric"] in {"us", "ms", "us_per_step", "us_per_step_filter+smooth"}
        ]
        timed = sorted((r for r in rows if r["peer"] != "LIMIT"), key=lambda r: r["median"])
        if timed and timed[0]["metric"].endswith("_per_s"):
            timed.reverse()
        if not timed or not any(r["peer"].startswith("trackrs") for r in timed):
            continue
        limit = sum(r["median"] for r in limits) / len(limits) if limits else None
        lines += ["", f"### {workload}, {size} ({timed[0]['metric']})", ""]
        if limit is not None:
            values = ", ".join(f"{r['median']:.3g}" for r in limits)
            lines += [f"LIMIT of this core, before and after: {values}", ""]
        lines += ["| who | median | min to max | x LIMIT | right |", "|---|---|---|---|---|"]
        for r in timed:
            ratio = "" if limit is None else f"{r['median'] / limit:.3g}"
            who, right = f"{r['peer']} {r.get('version', '')}".strip(), "yes" if r["correct"] else "no"
            spread = f"{r['min']:.4g} to {r['max']:.4g}"
            lines.append(f"| {who} | {r['median']:.4g} | {spread} | {ratio} | {right} |")
    return lines


def versions(records: list[dict]) -> list[str]:
    """Return who took part and who was not there."""
    took = sorted(
        {f"{r['peer']} {r.get('version', '')}".strip() for r in records if r["peer"] != "LIMIT" and "median" in r}
    )
    absent = sorted({r["peer"] for r in records if "median" not in r} - {r["peer"] for r in records if "median" in r})
    lines = ["", f"Python {platform.python_version()}. Took part: {', '.join(took)}."]
    return [*lines, f"Not there or refused: {', '.join(absent)}."] if absent else lines


def main() -> int:
    """Run all and write RESULTS.md; exit code 2 where the peers' folder is missing."""
    given = sys.argv[1] if len(sys.argv) > 1 else ""
    if not given or not (Path(given) / "common.py").is_file():
        print("make bench needs the folder of the peers' benchmark: make bench BENCH=path", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "peers"
        shutil.copytree(given, folder)
        for name in ("crossing_scan.py", "sparse_assignment.py"):
            shutil.copy(HERE / name, folder)
        subprocess.run(["sh", "build.sh"], cwd=folder / "climit", check=True)
        records = measure(folder)
    head = [
        "# Results",
        "",
        f"Written by `make bench` on one core of {platform.machine()} ({os.cpu_count()} in all). CPU time; read the",
        "ratio to the LIMIT row of the same run. The spread says how far to trust it.",
    ]
    grown = subprocess.run(
        [sys.executable, HERE / "scaling.py"], check=True, stdout=subprocess.PIPE, text=True
    ).stdout.splitlines()
    lines = [*head, *versions(records), *table(records), *grown, ""]
    (HERE / "RESULTS.md").write_text("\n".join(lines), encoding="utf-8")
    print(f"written: {HERE / 'RESULTS.md'}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
