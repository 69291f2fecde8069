#!/usr/bin/env python3
"""Live sessions of honest clients (honest.py) for a long time, again and again a while alone, then among jobs, watchers that
come and go, silent sessions, flooders and clients that never read: what else the machine does meets both alike. The honest ones
are a process of their own and the others, whose work belongs to other hosts, have a lower priority than the services: latencies
are those of the services.

    soak.py PLEAT [--minutes 60] [--sessions 24] [--rate 1] [--disturbers KIND...] [--judge]

Prints latencies (from sending a frame to having its answer) and the memory of the services, round by round; the first
round of about 5 minutes is for getting warm. Exit code 1 if an honest client lost a frame, got an error or was refused,
or a service was replaced; with --judge also if the mean memory of the last round is 1 % or more above that of the second, or the
99th percentile of latencies is not below twice the undisturbed one."""

import argparse
import atexit
import os
import pathlib
import queue
import random
import shutil
import subprocess
import sys
import threading
import time

import harness
from harness import common_pb2, coordinator_pb2, coordinator_pb2_grpc, grpc

ROUND_MINUTES = 5
ALONE = 0.2  # of a round
DISTURBERS = ["job", "fleeting_watcher", "silent_session", "silent_session", "deaf_session", "deaf_session", "flood", "garbage"]


def percentile(values, share):
    """NaN of none."""
    return sorted(values)[int(share * (len(values) - 1))] if values else float("nan")


class Soak:
    def __init__(self, options):
        self.up = harness.Up(options.pleat, str(harness.WORK / "data"))
        self.cloth, self.options = harness.garment("tablecloth"), options
        self.flood_message = coordinator_pb2.EnhanceRequest(open=coordinator_pb2.EnhanceOpen(
            subdivision_rounds=5, coarse=common_pb2.Topology(rest_positions=[0.0] * 3_000_000, faces=[0, 1, 2] * 300_000)))
        self.over, self.calm, self.disturbing = threading.Event(), threading.Event(), threading.Event()
        self.lock, self.faults, self.latencies = threading.Lock(), [], {False: [], True: []}
        self.warm, self.disturbances, self.at_work, self.counted = False, {}, 0, {False: 0, True: 0}

    def fault(self, text):
        with self.lock:
            self.faults.append(text)
        print(text, flush=True)

    def listen(self, clients):
        """To what the honest clients say: a latency a line, or what went wrong."""
        for line in clients.stdout:
            word, _, rest = line.rstrip().partition(" ")
            if word == "answered":
                with self.lock:
                    if self.warm and (self.at_work == 0 or self.disturbing.is_set()):
                        self.latencies[self.at_work > 0].append(float(rest))
            elif not self.over.is_set():
                self.fault(line.rstrip())

    def disturb(self, name, action):
        """Does it again and again; what happens to a disturber is its own affair."""
        def work():
            while self.disturbing.wait() and not self.over.is_set():
                with self.lock:
                    self.at_work += 1
                try:
                    with self.up.channel() as channel:
                        action(coordinator_pb2_grpc.CoordinatorStub(channel))
                except (grpc.RpcError, StopIteration):
                    pass
                with self.lock:
                    self.disturbances[name] = self.disturbances.get(name, 0) + 1
                self.calm.wait(random.random())
                with self.lock:
                    self.at_work -= 1
        threading.Thread(target=work, daemon=True).start()

    def job(self, stub):
        job = stub.CreateJob(coordinator_pb2.CreateJobRequest(scene=harness.falling_cloth(40, random.randrange(100))),
                             timeout=60)
        for event in stub.WatchJob(coordinator_pb2.WatchJobRequest(id=job.id, include_frames=True), timeout=300):
            if event.progress.state >= coordinator_pb2.Job.STATE_DONE:
                return
            if self.calm.is_set():
                stub.CancelJob(coordinator_pb2.CancelJobRequest(id=job.id), timeout=60)

    def fleeting_watcher(self, stub):
        jobs = stub.ListJobs(coordinator_pb2.ListJobsRequest(), timeout=10).jobs
        watch = stub.WatchJob(coordinator_pb2.WatchJobRequest(id=jobs[0].id if jobs else "none", include_frames=True),
                              timeout=20)
        for _ in range(random.randrange(1, 5)):
            next(watch)
        watch.cancel()

    def silent_session(self, stub):
        never = queue.Queue()
        answers = stub.Enhance(iter(never.get, None))
        self.calm.wait(20)
        answers.cancel()
        never.put(None)

    def deaf_session(self, stub):
        """Sends frames and takes no answer."""
        requests = queue.Queue()
        answers = stub.Enhance(iter(requests.get, None))
        requests.put(coordinator_pb2.EnhanceRequest(open=coordinator_pb2.EnhanceOpen(coarse=self.cloth)))
        for index in range(100):
            frame = common_pb2.Frame(index=index, positions=self.cloth.rest_positions)
            requests.put(coordinator_pb2.EnhanceRequest(frame=coordinator_pb2.EnhanceFrame(coarse=frame)))
        self.calm.wait(40)
        answers.cancel()
        requests.put(None)

    def flood(self, stub):
        """Large messages that are refused."""
        next(stub.Enhance(iter([self.flood_message]), timeout=30))

    def garbage(self, stub):
        channel = self.up.channel()
        call = channel.stream_stream("/pleat.v1.Coordinator/Enhance", request_serializer=bytes, response_deserializer=bytes)
        list(call(iter([os.urandom(2000)]), timeout=10))

    def memory_mb(self):
        return {name: harness.resident_mb(process) for name, process in self.up.services().items()}

    def watch_memory(self, seconds):
        """Samples of each service's memory, one a second."""
        samples, end = [], time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            time.sleep(min(1, left))
            samples.append(self.memory_mb())
        return samples

    def round(self, number, seconds):
        """Returns each service's mean memory."""
        self.disturbing.clear()
        self.calm.set()
        samples = self.watch_memory(ALONE * seconds)
        self.calm.clear()
        self.disturbing.set()
        samples += self.watch_memory((1 - ALONE) * seconds)
        memory = {name: sum(sample.get(name, 0) for sample in samples) / len(samples) for name in samples[0]}
        with self.lock:
            p99 = {disturbed: percentile(values[self.counted[disturbed]:], 0.99)
                   for disturbed, values in self.latencies.items()}
            self.counted = {disturbed: len(values) for disturbed, values in self.latencies.items()}
        print(f"  round {number}: p99 {1e3 * p99[False]:.0f} > {1e3 * p99[True]:.0f} ms, {sum(memory.values()):.0f} MB: "
              + ", ".join(f"{name} {mb:.0f}" for name, mb in memory.items()), flush=True)
        return memory

    def run(self):
        processes = self.up.services()
        clients = subprocess.Popen([sys.executable, pathlib.Path(__file__).with_name("honest.py"), self.up.address,
                                    str(self.options.sessions), str(self.options.rate)], stdout=subprocess.PIPE, text=True)
        atexit.register(clients.kill)
        threading.Thread(target=self.listen, args=[clients], daemon=True).start()
        os.nice(10)
        for name in self.options.disturbers:
            self.disturb(name, getattr(self, name))
        rounds = []
        count = max(3, round(self.options.minutes / ROUND_MINUTES))
        for number in range(count):
            self.warm = number > 0
            rounds.append(self.round(number, 60 * self.options.minutes / count))
        self.over.set()
        self.calm.set()
        clients.kill()
        if self.up.services() != processes:
            self.fault(f"services were replaced: {processes} -> {self.up.services()}")
        time.sleep(1)
        code = self.up.stop()
        if code:
            self.fault(f"`pleat up` ended with exit code {code}")
        return sum(rounds[1].values()), rounds[-1]

    def report(self, before, after):
        growth = sum(after.values()) / before - 1
        p99 = {}
        for disturbed, values in self.latencies.items():
            if not values:
                self.fault(f"no frames {'among disturbers' if disturbed else 'alone'}")
            p99[disturbed] = percentile(values, 0.99)
            print(f"{'among disturbers' if disturbed else 'alone'}: {len(values)} frames, latency median "
                  f"{1e3 * percentile(values, 0.5):.1f} ms, p99 {1e3 * p99[disturbed]:.1f} ms")
        print(f"memory {before:.0f} -> {sum(after.values()):.0f} MB ({100 * growth:+.2f} %): "
              f"{ {name: round(value) for name, value in after.items()} }")
        print(f"disturbances: {self.disturbances}; faults: {len(self.faults)}")
        bad = bool(self.faults)
        if self.options.judge:
            bad = bad or growth >= 0.01 or not p99[True] < 2 * p99[False]
        return 1 if bad else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pleat")
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument("--sessions", type=int, default=24)
    parser.add_argument("--rate", type=float, default=1,
                        help="frames a second of each session; 24 of them at 2 take two thirds of two cores")
    parser.add_argument("--disturbers", nargs="+", default=DISTURBERS, metavar="KIND", choices=DISTURBERS)
    parser.add_argument("--judge", action="store_true")
    options = parser.parse_args()
    soak = Soak(options)
    code = soak.report(*soak.run())
    sys.stdout.flush()
    shutil.rmtree(harness.WORK, True)
    os._exit(code)  # threads may still wait for a process that has gone


main()
