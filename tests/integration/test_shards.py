#!/usr/bin/env python3
"""Many workers on one data set's folder, killed and started twice, against one worker alone: PLEAT."""

import filecmp
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import time
import unittest

PLEAT = pathlib.Path(sys.argv[1]).resolve()
SEQUENCES = [f"sheet-{i:02}" for i in range(8)]
GARMENT = pathlib.Path(__file__).resolve().parents[2] / "deploy/garments/sheet.obj"  # a small one
SET = ["--set", "sheet", "--garment", GARMENT, "--rounds", "2", "--scale", "small", "--train", "6", "--test", "2",
       "--workers", "1"]


class Shards(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.temporary.cleanup)
        cls.folder = pathlib.Path(cls.temporary.name)
        cls.single = cls.folder / "single"
        subprocess.run([PLEAT, "dataset", "generate", cls.single, *SET, "-q"], check=True, stdout=subprocess.DEVNULL)

    def start(self, folder, *words, **environment):
        """A worker; its output is in FOLDER.PID.log."""
        log = tempfile.NamedTemporaryFile("w+", dir=self.folder, suffix=".log")
        self.addCleanup(log.close)
        worker = subprocess.Popen([PLEAT, "dataset", "generate", folder, *SET, "--lease", "2", *words], stdout=log,
                                  stderr=subprocess.STDOUT, env={**os.environ, **environment})
        worker.log = pathlib.Path(log.name)
        self.addCleanup(worker.wait)
        self.addCleanup(worker.kill)
        return worker

    def pleat(self, *words):
        return subprocess.run([PLEAT, "dataset", *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def wait_for_work(self, folder, worker):
        """Returns when the worker records a sequence, with its name."""
        while worker.poll() is None:
            for lease in (folder / "shards/leases").glob("*"):
                owner = lease.read_text().partition("owner ")[2].split("\n")[0].split()
                partial = folder / "shards/work" / lease.name / "sequences" / (lease.stem + ".h5.partial")
                if len(owner) == 3 and owner[1] == str(worker.pid) and partial.exists():
                    return lease.stem
            time.sleep(0.01)
        self.fail("the worker ended before it recorded anything: " + worker.log.read_text())

    def assert_same_as_single(self, folder):
        self.assertEqual(sorted(p.name for p in (folder / "sequences").iterdir()), [n + ".h5" for n in SEQUENCES])
        for name in ["dataset.h5", *(f"sequences/{name}.h5" for name in SEQUENCES)]:
            self.assertTrue(filecmp.cmp(self.single / name, folder / name, shallow=False), name)
        self.assertFalse((folder / "shards").exists())

    def test_workers_that_die_and_come_twice(self):
        folder = self.folder / "many"
        workers = [self.start(folder, "--shard", f"{i}/4") for i in (1, 2, 3, 4, 3)]
        victim = workers.pop(1)
        left_behind = self.wait_for_work(folder, victim)
        victim.kill()
        self.assertEqual(victim.wait(), -signal.SIGKILL)
        self.assertFalse((folder / "sequences" / (left_behind + ".h5")).exists())
        for worker in workers:
            self.assertIn(worker.wait(), (0, 75), worker.log.read_text())
        # Of those that ended at the end, none left while nobody alive held what is missing; the same command completes it.
        while (again := self.start(folder, "--shard", "2/4")).wait() == 75:
            pass
        self.assertEqual(again.returncode, 0, again.log.read_text())
        self.assertTrue((folder / "shards/leases" / (left_behind + ".2")).exists(), "nobody took it over")
        verified = self.pleat("verify", folder, "--stride", "20")
        self.assertEqual(verified.returncode, 0, verified.stdout)
        self.assertIn("not merged yet: 0 sequences", verified.stdout)
        merged = self.pleat("merge", folder)
        self.assertEqual(merged.returncode, 0, merged.stdout)
        self.assert_same_as_single(folder)
        self.assertEqual(self.pleat("verify", folder, "--stride", "20").returncode, 0)

    def test_a_signal_ends_a_worker_at_a_checkpoint(self):
        folder = self.folder / "stopped"
        array = {"SLURM_ARRAY_TASK_ID": "4", "SLURM_ARRAY_TASK_MIN": "3", "SLURM_ARRAY_TASK_COUNT": "2"}
        worker = self.start(folder, **array)
        self.wait_for_work(folder, worker)
        worker.terminate()
        self.assertEqual(worker.wait(), 75, worker.log.read_text())
        self.assertIn("shard 2 of 2 (SLURM_ARRAY_TASK_ID)", worker.log.read_text())
        self.assertEqual(self.pleat("merge", folder).returncode, 75)
        again = self.start(folder, JOB_COMPLETION_INDEX="0", JOB_COMPLETIONS="1")
        self.assertEqual(again.wait(), 0, again.log.read_text())
        self.assertEqual(self.pleat("merge", folder).returncode, 0)
        self.assert_same_as_single(folder)

    def test_what_can_never_be_done_is_said_at_once(self):
        folder = self.folder / "refused"
        self.assertEqual(self.start(folder, "--shard", "5/4").wait(), 2)
        self.assertEqual(self.start(folder, JOB_COMPLETION_INDEX="0").wait(), 2)
        worker = self.start(folder, "--shard", "1/1")
        self.wait_for_work(folder, worker)
        worker.terminate()
        self.assertEqual(worker.wait(), 75)
        self.assertEqual(self.start(folder, "--shard", "1/1", "--seed", "2").wait(), 2, "other options")
        self.assertEqual(self.start(folder, "--shard", "none").wait(), 2, "no shard among shards")
        self.assertEqual(self.pleat("merge", self.folder / "absent").returncode, 2)


unittest.main(argv=sys.argv[:1], verbosity=2)
