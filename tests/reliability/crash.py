#!/usr/bin/env python3
"""Kills random processes of Pleat (kill -9, never later than 30 s after the last one) while jobs run, in changing set-ups,
and compares each result with that of an undisturbed job: the same bits, and nothing lost.

    crash.py PLEAT [--minutes 100] [--rounds N] [--seed 1]

One line a round; exit code 1 if a result differs or a job is lost."""

import argparse
import os
import random
import signal
import sys
import time

import harness
from harness import WORK, common_pb2, coordinator_pb2, grpc

JOB_LIMIT_S = 900
DONE = coordinator_pb2.Job.STATE_DONE
# Cloth, bundle and what makes the wrinkles. The fold step goes on from its last answer, and so does the bundle "sheet-81".
SET_UPS = {
    "fold": (harness.falling_cloth, "", common_pb2.DETAIL_FOLD),
    "network": (harness.falling_cloth, "draping", common_pb2.DETAIL_NETWORK),
    "both": (harness.falling_cloth, "draping", common_pb2.DETAIL_BOTH),
    "network that remembers": (harness.falling_sheet, "sheet-81", common_pb2.DETAIL_NETWORK),
    "both, remembering": (harness.falling_sheet, "sheet-81", common_pb2.DETAIL_BOTH),
}


class Job:
    """One set-up: what is simulated, and who may be killed."""

    def __init__(self, random_, number):
        self.set_up = random_.choice(sorted(SET_UPS))
        self.frames = random_.choice([20, 45, 70, 110])
        self.scene_seed = random_.randrange(3)
        self.reference = random_.random() < 0.25
        self.launcher_too = random_.random() < 0.4
        self.kills = random_.randrange(1, 5)
        self.pause_s = random_.choice([0.3, 1, 3])
        self.name = f"crash-{number}"

    def what(self):
        return (self.set_up, self.frames, self.scene_seed, self.reference)

    def request(self):
        make_scene, model, detail = SET_UPS[self.set_up]
        return coordinator_pb2.CreateJobRequest(scene=make_scene(self.frames, self.scene_seed), model=model,
                                                detail=detail, reference=self.reference, job_id=self.name)


class Crash:
    def __init__(self, pleat, seed):
        self.pleat, self.random = pleat, random.Random(seed)
        self.expected, self.kills, self.up = {}, {}, None
        self.data = str(WORK / "data")

    def start(self):
        self.up = harness.Up(self.pleat, self.data)

    def ask(self, call, limit_s=120):
        """A call that is made again while the coordinator is away."""
        deadline = time.monotonic() + limit_s
        while True:
            try:
                return call(self.up.coordinator())
            except grpc.RpcError as error:
                if error.code() != grpc.StatusCode.UNAVAILABLE or time.monotonic() > deadline:
                    raise
                time.sleep(0.1)

    def finish(self, job):
        """The bits of the finished job."""
        deadline = time.monotonic() + JOB_LIMIT_S
        while True:
            record = self.ask(lambda stub: stub.GetJob(coordinator_pb2.GetJobRequest(id=job.name), timeout=30))
            if record.state == DONE:
                return harness.bits(record.result_path)
            if record.state > DONE or time.monotonic() > deadline:
                raise RuntimeError(f"{coordinator_pb2.Job.State.Name(record.state)}, {record.frames_complete} of "
                                   f"{record.frames} frames: {record.error}")
            time.sleep(0.1)

    def run_undisturbed(self, job):
        name, job.name = job.name, job.name + "-undisturbed"
        self.ask(lambda stub: stub.CreateJob(job.request(), timeout=60))
        result = self.finish(job)
        job.name = name
        return result

    def disturb(self, job):
        for _ in range(job.kills):
            time.sleep(min(30, self.random.expovariate(1 / job.pause_s)))
            services = self.up.services()
            if job.launcher_too and self.random.random() < 0.3:
                victim = "launcher"
                self.up.kill()
                while any(os.path.exists(f"/proc/{process}") for process in services.values()):
                    time.sleep(0.02)  # they end with it
                self.start()
            elif services:
                victim = self.random.choice(sorted(services))
                os.kill(services[victim], signal.SIGKILL)
            else:
                continue
            self.kills[victim] = self.kills.get(victim, 0) + 1
            yield victim

    def round(self, number):
        job = Job(self.random, number)
        if job.what() not in self.expected:
            self.expected[job.what()] = self.run_undisturbed(job)
        self.ask(lambda stub: stub.CreateJob(job.request(), timeout=60))
        killed = list(self.disturb(job))
        try:
            right = self.finish(job) == self.expected[job.what()]
            outcome = "same bits" if right else "OTHER BITS"
        except RuntimeError as error:
            right, outcome = False, f"LOST: {error}"
        print(f"{number}: {job.set_up}, {job.frames} frames{' and a reference' if job.reference else ''}, killed {killed}: {outcome}",
              flush=True)
        return right


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pleat")
    parser.add_argument("--minutes", type=float, default=100)
    parser.add_argument("--rounds", type=int, default=10**9)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    crash = Crash(options.pleat, options.seed)
    crash.start()
    deadline, number, wrong = time.monotonic() + 60 * options.minutes, 0, 0
    while number < options.rounds and time.monotonic() < deadline:
        number += 1
        wrong += not crash.round(number)
    code = crash.up.stop()
    print(f"{sum(crash.kills.values())} kills {crash.kills}, {number - wrong} of {number} results with the same bits, "
          f"`pleat up` ended with exit code {code}")
    sys.exit(1 if wrong or code else 0)


main()
