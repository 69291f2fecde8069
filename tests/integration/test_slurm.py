#!/usr/bin/env python3
"""deploy/slurm on a Slurm of four nodes on this host, which are lost one after the other: SOURCE PLEAT TRAIN. Exit code 77:
there is no Slurm (Debian: slurm-wlm munge)."""

import csv
import filecmp
import json
import pathlib
import subprocess
import sys
import tempfile
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import slurm_cluster

if missing := slurm_cluster.missing_programs():
    print(f"skipped: no {', '.join(missing)} (Debian: slurm-wlm munge)")
    sys.exit(77)

SOURCE, PLEAT, TRAIN = (pathlib.Path(argument).resolve() for argument in sys.argv[1:4])
SEQUENCES = [f"sheet-{i:02}" for i in range(8)]
GARMENT = SOURCE / "deploy/garments/sheet.obj"  # a small one
SET = ["--set", "sheet", "--garment", str(GARMENT), "--rounds", "2", "--scale", "small", "--train", "6", "--test", "2"]


class Slurm(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        temporary = tempfile.TemporaryDirectory()
        cls.addClassCleanup(temporary.cleanup)
        cls.folder = pathlib.Path(temporary.name)
        (cls.folder / "slurm").mkdir()
        cls.cluster = cls.enterClassContext(slurm_cluster.Cluster(cls.folder / "slurm", nodes=4))
        # Names of nodes that no resolver knows.
        cls.cluster.environment.update(PLEAT=str(PLEAT), PLEAT_TRAIN=str(TRAIN), PLEAT_RENDEZVOUS_HOST="127.0.0.1")
        cls.single = cls.folder / "single"
        subprocess.run([PLEAT, "dataset", "generate", cls.single, *SET, "--workers", "1", "-q"], check=True,
                       stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def submit(self, script, *words, options=()):
        return self.cluster.submit("--cpus-per-task=1", "--chdir", SOURCE, "--output", self.folder / "%x-%A-%a.log", *options,
                                   SOURCE / "deploy/slurm" / script, *words)

    def logs(self):
        return "\n".join(f"{log.name}:\n{log.read_text()[-2000:]}" for log in self.folder.glob("*.log"))

    def wait_for(self, job, seconds=400):
        """Until none of its tasks is in the queue any more. Returns what Slurm knows of each, text."""
        try:
            self.cluster.wait_until(lambda: not any(task.split("_")[0] == job for task in self.cluster.jobs()),
                                    f"job {job} does not end", seconds)
        except RuntimeError as error:
            self.fail(f"{error}\n{self.cluster.jobs()}\n{self.logs()}")
        return self.cluster.run("scontrol", "show", "job", job).stdout.split("\n\n")

    def wait_until(self, condition, message):
        """The condition's answer, once it has one."""
        answers = []
        self.cluster.wait_until(lambda: answers.append(condition()) or answers[-1], message + ": " + self.logs())
        return answers[-1]

    @staticmethod
    def task_at_work(folder):
        """The node and array index of a task that records a sequence; None if there is none at the moment."""
        for partial in (folder / "shards/work").glob("*/sequences/*.h5.partial"):
            try:
                owner = (folder / "shards/leases" / partial.parts[-3]).read_text().partition("owner ")[2].split()[1]
                variables = pathlib.Path(f"/proc/{owner}/environ").read_bytes().decode().split("\0")
            except OSError:
                continue  # it has just ended
            known = dict(line.partition("=")[::2] for line in variables)
            return known["SLURMD_NODENAME"], known["SLURM_ARRAY_TASK_ID"]
        return None

    def test_1_a_data_set_by_an_array_that_loses_a_node(self):
        many = self.folder / "many"
        data = self.submit("data.sbatch", many, *SET, "--lease", "2", options=["--array=1-4"])
        merge = self.submit("merge.sbatch", many, options=[f"--dependency=afterok:{data}"])
        node, index = self.wait_until(lambda: self.task_at_work(many), "nobody makes anything")
        self.cluster.crash_node(node)
        tasks = self.wait_for(data)
        lost = [task for task in tasks if f"ArrayTaskId={index} " in task]
        self.assertEqual(len(lost), 1, tasks)
        self.assertRegex(lost[0], r"Restarts=[1-9]", "the task of the lost node was not requeued")
        self.assertIn("JobState=COMPLETED", self.wait_for(merge)[0], self.logs())
        self.assertEqual(sorted(p.name for p in (many / "sequences").iterdir()), [n + ".h5" for n in SEQUENCES])
        for name in ["dataset.h5", *(f"sequences/{name}.h5" for name in SEQUENCES)]:
            self.assertTrue(filecmp.cmp(self.single / name, many / name, shallow=False), name)

    def losses(self, output):
        """Rows of log.csv, without the minutes."""
        with open(output / "log.csv") as log:
            return [[float(cell) for i, cell in enumerate(row) if i != 2] for row in list(csv.reader(log))[1:]]

    def test_2_a_training_over_two_nodes_that_loses_one(self):
        config = self.folder / "train.json"
        config.write_text(json.dumps({
            "name": "small", "dataset": str(self.single), "output": str(self.folder / "two"),
            "images": {"layout": "detail", "coarse_width": 12, "coarse_height": 9},
            "architecture": {"blocks": 1, "layers": 2, "growth": 8, "features": 8, "upsampling": "subpixel"},
            "losses": {"kinematic": 0}, "epochs": 6, "batch": 4, "patch": 0, "steps_per_epoch": 40, "threads": 1,
            "device": "cpu", "checkpoint_minutes": 0, "schedule": {"kind": "constant"}}))
        subprocess.run([TRAIN, config, "--set", f"output={self.folder / 'one'}"], check=True, stdout=subprocess.DEVNULL)
        job = self.submit("train.sbatch", config, options=["--nodes=2"])
        log = self.folder / "two/log.csv"
        self.wait_until(lambda: log.exists() and len(log.read_text().splitlines()) > 2, "the training makes no steps")
        nodes = self.cluster.run("squeue", "--noheader", "--job", job, "--format=%N").stdout.strip()
        last = self.cluster.run("scontrol", "show", "hostnames", nodes).stdout.split()[-1]
        self.cluster.crash_node(last)
        ended = self.wait_for(job)[0]
        self.assertIn("JobState=COMPLETED", ended, self.logs())
        self.assertNotIn("Restarts=0", ended)
        self.assertIn("resumed at epoch", self.logs())
        one, two = self.losses(self.folder / "one"), self.losses(self.folder / "two")
        self.assertEqual(len(one), len(two))
        for mine, theirs in zip(one, two):
            for a, b in zip(mine[:3], theirs[:3]):  # epoch, steps, loss: the same up to the order of sums
                self.assertAlmostEqual(a, b, delta=1e-3 * abs(a))


unittest.main(argv=sys.argv[:1], verbosity=2)
