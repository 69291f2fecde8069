"""Frames per second of the whole pipeline with N replicas of one stage, each in a share of a core."""

import itertools
import pathlib
import random
import subprocess
import sys
import tempfile
import threading
import time

import shares

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "reliability"))
import harness  # noqa: E402
from harness import common_pb2, coordinator_pb2, coordinator_pb2_grpc, grpc  # noqa: E402

STAGES = ("simulation", "conversion", "superres", "fold", "refinement")
WINDOW = 8  # frames in flight of a session
CLOTH = "tablecloth"


class Services:
    """One service of each kind in this host's own processors, `replicas` of `stage` in a share of a core each."""

    def __init__(self, programs, stage, replicas, cores):
        self.folder = tempfile.TemporaryDirectory(prefix="pleat-scale-")
        folder = pathlib.Path(self.folder.name)
        self.children, addresses = {}, {}
        for kind in STAGES:
            own = [shares.Share(cores) for _ in range(replicas)] if kind == stage else [None]
            addresses[kind] = []
            for k, share in enumerate(own):
                address = f"unix:{folder}/{kind}-{k}"
                addresses[kind].append(address)
                words = [programs / f"pleat-{kind}", "--listen", address, "--log-level", "warn", "--die-with-parent"]
                if kind != "conversion" and share:
                    words += ["--threads", "1"]
                self._start(kind, words, share)
        self.address = f"unix:{folder}/coordinator"
        self._start("coordinator", [programs / "pleat-coordinator", "--listen", self.address, "--data", folder / "data",
                                    "--jobs", "16", "--compress=false", "--log-level", "warn", "--die-with-parent",
                                    *(f"--{kind}={','.join(addresses[kind])}" for kind in STAGES)])
        self.channel = grpc.insecure_channel(self.address, options=[("grpc.max_receive_message_length", harness.MAX_MESSAGE)])
        grpc.channel_ready_future(self.channel).result(60)

    def _start(self, kind, words, share=None):
        self.children.setdefault(kind, []).append(shares.start(
            words, share, stdout=subprocess.DEVNULL, stderr=open(f"{self.folder.name}/{kind}.log", "a", encoding="utf-8")))

    def cpu_seconds(self):
        """Of each kind of process, all replicas together."""
        return {kind: sum(map(shares.cpu_seconds, children)) for kind, children in self.children.items()}

    def stop(self):
        self.channel.close()
        for child in self.children.pop("coordinator") + [child for kind in self.children.values() for child in kind]:
            shares.stop(child)
        self.folder.cleanup()


class LiveLoad:
    """Sessions that keep WINDOW frames in flight. What is sent was packed before, and answers are not unpacked: the load takes
    little of the processors that it measures."""

    def __init__(self, services, sessions, model):
        self.answered, self.over, self.error = itertools.count(), threading.Event(), None
        self.total = 0
        self._enhance = services.channel.stream_stream("/pleat.v1.Coordinator/Enhance", lambda data: data, lambda data: data)
        cloth = harness.garment(CLOTH)
        self._open = coordinator_pb2.EnhanceRequest(open=coordinator_pb2.EnhanceOpen(
            coarse=cloth, model=model, window=WINDOW, detail=common_pb2.DETAIL_NETWORK)).SerializeToString()
        noise = random.Random(1)
        moved = [x + noise.uniform(-1e-3, 1e-3) for x in cloth.rest_positions]
        self._frames = [coordinator_pb2.EnhanceRequest(frame=coordinator_pb2.EnhanceFrame(coarse=common_pb2.Frame(
            positions=positions))).SerializeToString() for positions in (cloth.rest_positions, moved)]
        self._threads = [threading.Thread(target=self._session, daemon=True) for _ in range(sessions)]
        for thread in self._threads:
            thread.start()

    def _session(self):
        room = threading.Semaphore(WINDOW)

        def requests():
            yield self._open
            for index in itertools.count():
                room.acquire()
                if self.over.is_set():
                    return
                # A message appended to another is merged into it.
                yield self._frames[index % 2] + coordinator_pb2.EnhanceRequest(frame=coordinator_pb2.EnhanceFrame(
                    coarse=common_pb2.Frame(index=index))).SerializeToString()

        try:
            answers = self._enhance(requests())
            next(answers)  # `opened`
            for _ in answers:
                room.release()
                self.total += 1
        except grpc.RpcError as error:
            if not self.over.is_set():
                self.error = error

    def frames(self):
        if self.error:
            raise RuntimeError(f"a session ended: {self.error}")
        return self.total

    def stop(self):
        self.over.set()


class JobLoad:
    """Jobs whose frames cost little behind the simulation."""

    def __init__(self, services, jobs):
        self._coordinator = coordinator_pb2_grpc.CoordinatorStub(services.channel)
        self._ids = []
        for k in range(jobs):
            scene = harness.scene(f"load-{k}", CLOTH, 100_000, k, 1e-3, [0, 20])
            job = self._coordinator.CreateJob(coordinator_pb2.CreateJobRequest(
                scene=scene, frames=100_000, detail=common_pb2.DETAIL_COARSE))
            self._ids.append(job.id)

    def frames(self):
        total = 0
        for each in self._ids:
            job = self._coordinator.GetJob(coordinator_pb2.GetJobRequest(id=each))
            if job.error:
                raise RuntimeError(f"a job ended: {job.error}")
            total += job.frames_complete
        return total

    def stop(self):
        for each in self._ids:
            self._coordinator.CancelJob(coordinator_pb2.CancelJobRequest(id=each))


def measure(programs, stage, replicas, cores, seconds, clients):
    """{"frames_per_s", "cpu_ms": {process: per frame}} with so many clients, in steady state."""
    services = Services(programs, stage, replicas, cores)
    try:
        load = JobLoad(services, clients) if stage == "simulation" else LiveLoad(services, clients, "")
        begin = time.monotonic()
        while load.frames() < 10 * clients or time.monotonic() - begin < 3:
            if time.monotonic() - begin > 120:
                raise RuntimeError(f"{replicas} replicas of {stage} answered {load.frames()} frames in two minutes")
            time.sleep(0.1)
        cpu, frames, begin = services.cpu_seconds(), load.frames(), time.monotonic()
        time.sleep(seconds)
        frames, elapsed = load.frames() - frames, time.monotonic() - begin
        used = {kind: seconds - cpu[kind] for kind, seconds in services.cpu_seconds().items()}
        load.stop()
        return {"frames_per_s": frames / elapsed, "cpu_ms": {kind: 1e3 * s / max(1, frames) for kind, s in used.items()}}
    finally:
        services.stop()
