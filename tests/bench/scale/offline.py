"""Data sets and trainings by N processes, each in a share of a core."""

import csv
import pathlib
import tempfile
import time

import shares
import slurm_cluster

SET = ["--set", "sheet", "--scale", "small", "--test", "1", "--workers", "1"]


def data(programs, workers, cores, sequences_each):
    """Sequences per hour of a set that `workers` make together in one folder, its merging not counted."""
    with tempfile.TemporaryDirectory(prefix="pleat-scale-") as folder:
        count = workers * sequences_each
        begin = time.monotonic()
        children = [shares.start([programs / "pleat", "dataset", "generate", f"{folder}/set", *SET, "--train", count - 1,
                                  "--shard", f"{k + 1}/{workers}", "--lease", "10", "-q"], shares.Share(cores))
                    for k in range(workers)]
        # 75: it has nothing to do any more, and others are not done yet.
        codes = [child.wait() for child in children]
        elapsed = time.monotonic() - begin
        made = len(list(pathlib.Path(folder, "set/shards").glob("**/sequences/*.h5"))) or \
            len(list(pathlib.Path(folder, "set/sequences").glob("*.h5")))
        if made != count or any(code not in (0, 75) for code in codes):
            raise RuntimeError(f"{workers} workers made {made} of {count} sequences, exit codes {codes}")
        return 3600 * count / elapsed


def make_dataset(programs, folder):
    shares.start([programs / "pleat", "dataset", "generate", folder, *SET, "--train", 3, "-q"]).wait()
    return folder


def training(programs, dataset, processes, cores, epochs, config):
    """(seconds of a step, loss of each epoch) of one training by so many processes."""
    with tempfile.TemporaryDirectory(prefix="pleat-scale-") as folder:
        rendezvous = f"127.0.0.1:{slurm_cluster.free_ports(1)[0]}"
        together = ["--rendezvous", rendezvous, "--processes", processes] if processes > 1 else []
        settings = {"dataset": dataset, "output": folder, "epochs": epochs, "max_minutes": 1000, "threads": 1}
        words = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
        children = [shares.start([programs / "pleat-train", config, *words, *together,
                                  *(["--rank", rank] if processes > 1 else [])], shares.Share(cores),
                                 stdout=open(f"{folder}/{rank}.log", "w"), stderr=-2) for rank in range(processes)]
        if any([child.wait() for child in children]):
            raise RuntimeError(pathlib.Path(folder, "0.log").read_text()[-2000:])
        with open(next(pathlib.Path(folder).glob("**/log.csv")), encoding="ascii") as log:
            rows = list(csv.DictReader(log))
        # The first epoch holds the start.
        steps = int(rows[-1]["steps"]) - int(rows[0]["steps"])
        return 60 * (float(rows[-1]["minutes"]) - float(rows[0]["minutes"])) / steps, [float(row["total"]) for row in rows]
