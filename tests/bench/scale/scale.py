#!/usr/bin/env python3
"""How Pleat scales: N processes, each limited to a share of a core, against one with the same share.

    scale.py BUILD [PART...] [--share 0.1] [--seconds 20] [--price 0.04] [--json FILE]

Parts: `superres` and `simulation` (frames per second of the pipeline with 1 to 4 replicas), `data` (sequences per hour by 1 and 4
workers), `training` (a step by 1, 2 and 4 processes, and the curve), `paper` (a queueing model from the times that the others
have measured, checked against them: up to 1,000 sessions), `cost` (per core-hour, and per dollar at --price for a core-hour).
All of them without a name. Needs root, cgroups with the cpu controller, two processors that do nothing else, and about 20 minutes.
Exit code 1 if a figure of the table in docs/operations.md is missed, 77 if shares can't be had here."""

import argparse
import json
import os
import pathlib
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path[:0] = [str(pathlib.Path(__file__).resolve().parent), str(ROOT / "tests/integration")]

import offline  # noqa: E402
import queueing  # noqa: E402
import serving  # noqa: E402
import shares  # noqa: E402

PARTS = ("superres", "simulation", "data", "training", "paper", "cost")
LEAST = {"superres": 0.9, "simulation": 0.9, "data": 0.9, "training": 0.85}  # of N times one
SESSIONS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
SESSION_RATE = 25  # frames per second that an artist's session sends


class Run:
    def __init__(self, options):
        self.options, self.programs = options, options.build.resolve() / "bin"
        self.figures, self.missed = {}, []

    def judge(self, part, n, efficiency):
        if efficiency < LEAST[part]:
            self.missed.append(f"{part}, {n}: {efficiency:.2f} of {n} times one, must be {LEAST[part]}")

    def replicas(self, stage):
        """Two clients a replica, so that each has the same batches for every N."""
        rows = []
        for n in (1, 2, 3, 4):
            row = serving.measure(self.programs, stage, n, self.options.share, self.options.seconds, 2 * n)
            row["efficiency"] = row["frames_per_s"] / n / (rows[0] if rows else row)["frames_per_s"]
            rows.append(row)
            self.judge(stage, n, row["efficiency"])
            cpu = ", ".join(f"{kind} {ms:.2f}" for kind, ms in row["cpu_ms"].items() if ms > 0.05)
            print(f"{stage:11} {n} replicas  {row['frames_per_s']:8.2f} frames/s  {row['efficiency']:.3f} of N   ms of a core: {cpu}",
                  flush=True)
        self.figures[stage] = rows

    def data(self):
        share = 4 * self.options.share
        rows = []
        for n in (1, 4):
            rate = offline.data(self.programs, n, share, 4)
            rows.append({"workers": n, "sequences_per_hour": rate, "cores": n * share})
            efficiency = rate / n / rows[0]["sequences_per_hour"]
            self.judge("data", n, efficiency)
            print(f"data        {n} workers   {rate:8.1f} sequences/h  {efficiency:.3f} of N", flush=True)
        self.figures["data"] = rows

    def training(self):
        share = 4 * self.options.share
        rows = []
        with tempfile.TemporaryDirectory(prefix="pleat-scale-") as folder:
            dataset = offline.make_dataset(self.programs, f"{folder}/set")
            for n in (1, 2, 4):
                step, losses = offline.training(self.programs, dataset, n, share, 4, self.options.config)
                first = rows[0] if rows else {"step_s": step, "losses": losses}
                efficiency = first["step_s"] / n / step
                apart = max(abs(a - b) / abs(b) for a, b in zip(losses, first["losses"]))
                rows.append({"processes": n, "step_s": step, "losses": losses, "cores": n * share})
                self.judge("training", n, efficiency)
                print(f"training    {n} processes {step:8.3f} s a step     {efficiency:.3f} of N   curve: {apart:.1e} apart", flush=True)
        self.figures["training"] = rows

    def stations(self, cpu_ms, replicas=None, cores=1.0):
        """The stages that a frame of a live session visits, by their processor time."""
        names = [name for name in ("coordinator", "conversion", "superres", "refinement") if cpu_ms.get(name, 0) > 0]
        return [queueing.Station(name, cpu_ms[name] / 1e3 / cores, (replicas or {}).get(name, 1)) for name in names]

    def paper(self):
        rows = self.figures.get("superres")
        if not rows:
            raise SystemExit("paper: needs the part `superres` in the same run")
        host = os.cpu_count()
        print("\nOn paper, checked against the measured points:")
        checks = []
        cpu = rows[0]["cpu_ms"]  # of one replica: what more of them do is foretold, not looked up
        for n, row in enumerate(rows, 1):
            others = sum(ms for kind, ms in cpu.items() if kind != "superres") / 1e3
            stations = [queueing.Station("superres", cpu["superres"] / 1e3 / self.options.share, n),
                        queueing.Station("the host's others", others, host - n * self.options.share)]
            predicted, _ = queueing.solve(stations, 2 * n * serving.WINDOW)
            off = predicted / row["frames_per_s"] - 1
            checks.append(off)
            print(f"  {n} replicas of superres: {predicted:.2f} frames/s, measured {row['frames_per_s']:.2f} ({100 * off:+.1f} %)")
            if abs(off) > 0.1:
                self.missed.append(f"paper, {n} replicas: {100 * off:+.1f} % off")
        # A core for each process, replicas so that none is busier than 80 %.
        mean = {kind: sum(row["cpu_ms"][kind] for row in rows) / len(rows) for kind in rows[0]["cpu_ms"]}
        print(f"\nSessions of {SESSION_RATE} frames/s, a core for each process; replicas so that none is busier than 80 %:")
        print("  sessions  frames/s  ms in the pipeline  first to saturate        replicas: conversion superres refinement  coordinators")
        table = []
        for sessions in SESSIONS:
            rate = sessions * SESSION_RATE
            replicas = {kind: queueing.replicas_for(mean[kind] / 1e3, rate) for kind in ("conversion", "superres", "refinement", "coordinator")}
            stations = self.stations(mean, replicas)
            throughput, response = queueing.solve(stations, sessions, think_s=max(0.0, 1 / SESSION_RATE))
            single = queueing.bottleneck(self.stations(mean))
            table.append({"sessions": sessions, "frames_per_s": throughput, "response_ms": 1e3 * response, "replicas": replicas})
            print(f"  {sessions:8}  {throughput:8.0f}  {1e3 * response:18.1f}  {queueing.bottleneck(stations).name:23}            "
                  f"{replicas['conversion']:8.0f} {replicas['superres']:8.0f} {replicas['refinement']:10.0f}  {replicas['coordinator']:12.0f}")
        alone = 1e3 / mean["coordinator"] / SESSION_RATE
        print(f"  One of each: {single.name} is full at {single.capacity:.0f} frames/s, {single.capacity / SESSION_RATE:.0f} sessions. "
              f"One coordinator's core is full at {alone:.0f} sessions: shard coordinators beyond {0.8 * alone:.0f}.")
        self.figures["paper"] = {"errors": checks, "table": table, "first_to_saturate": single.name,
                                 "sessions_of_a_coordinator": alone, "cpu_ms": mean}

    def cost(self):
        price = self.options.price
        print(f"\nPer core-hour, and per dollar at {price} $ a core-hour:")
        rows = []

        def row(what, unit, per_core_hour):
            rows.append({"what": what, "unit": unit, "per_core_hour": per_core_hour, "per_dollar": per_core_hour / price})
            print(f"  {what:38} {per_core_hour:12,.0f} {unit:12} {per_core_hour / price:14,.0f} a dollar")

        for each in self.figures.get("data", []):
            row(f"data, {each['workers']} workers", "sequences", each["sequences_per_hour"] / each["cores"])
        for each in self.figures.get("training", []):
            row(f"training, {each['processes']} processes", "steps", 3600 / each["step_s"] / each["cores"])
        for stage in ("superres", "simulation"):
            for n, each in enumerate(self.figures.get(stage, []), 1):
                row(f"{'serving' if stage == 'superres' else 'simulation'}, {n} replicas", "frames",
                    3600e3 / sum(each["cpu_ms"].values()))
        if "paper" in self.figures:
            mean = self.figures["paper"]["cpu_ms"]
            for n in (1, 2, 4, 8):
                counts = {kind: n for kind in mean}
                single = queueing.bottleneck(self.stations(mean, counts))
                used = sum(mean[s.name] for s in self.stations(mean)) / 1e3 * single.capacity
                row(f"serving on paper, {n} of each, cores full", "frames", 3600 * single.capacity / max(used, 1e-9))
        self.figures["cost"] = rows


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], metavar="PART")
    parser.add_argument("--share", type=float, default=0.1, help="of a core, for each replica; data and training: four times that")
    parser.add_argument("--seconds", type=float, default=20, help="of a point of serving")
    parser.add_argument("--price", type=float, default=0.04, help="of a core-hour, dollars")
    parser.add_argument("--config", type=pathlib.Path, default=pathlib.Path(__file__).with_name("training.json"))
    parser.add_argument("--json", type=pathlib.Path)
    options = parser.parse_args()
    run = Run(options)
    try:
        for part in options.parts or PARTS:
            run.replicas(part) if part in ("superres", "simulation") else getattr(run, part)()
    except shares.Unavailable as error:
        print(f"skipped: {error}")
        return 77
    if options.json:
        options.json.write_text(json.dumps(run.figures, indent=2))
    for line in run.missed:
        print(f"missed: {line}")
    return 1 if run.missed else 0


if __name__ == "__main__":
    sys.exit(main())
