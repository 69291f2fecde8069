"""Sessions and jobs of a coordinator."""

from __future__ import annotations

import collections
import os
import pathlib
import queue
import subprocess
import tempfile
import time
from dataclasses import dataclass
from typing import Any, Callable, Dict, Iterable, Iterator, List, Optional, Sequence as Sequence_

import grpc
import numpy as np
import numpy.typing as npt

from pleat.files import Result
from pleat.local import LocalServices
from pleat.mesh import Mesh, Obstacle
from pleat.v1 import common_pb2, coordinator_pb2, coordinator_pb2_grpc

_MESSAGE_LIMIT = 64 << 20
_CHECKPOINT_INTERVAL = 25  # frames
_MOST_KEPT = 4 * _CHECKPOINT_INTERVAL + 64


class PleatError(RuntimeError):
    """What the coordinator says, or why it can't be reached; one line."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(f"{code}: {message}")
        self.code = code  #: name of the gRPC status, for example "INVALID_ARGUMENT"


class FrameFailed(PleatError):
    """A frame that could not be enhanced."""


@dataclass
class EnhancedFrame:
    """One answer."""

    index: int
    time_s: float
    positions: npt.NDArray[np.float32]  #: (V_fine, 3) metres
    report: common_pb2.RefinementReport  #: what refinement found and did
    stage_ms: Dict[str, float]


@dataclass
class Job:
    """A job of a coordinator, as it was when asked for."""

    id: str
    scene: str
    state: str  #: "queued", "running", "reference", "done", "failed", "cancelled"
    frames: int
    frames_complete: int
    error: str
    result_path: str  #: on the coordinator's host
    owner: str
    trace_id: str  #: in the log lines of all services that work on it


class Session:
    """A live session. Close it, or use it in a `with`."""

    def __init__(self, client: "Client", garment: Mesh, model: str, frame_time_s: float, obstacles: Sequence_[Obstacle],
                 window: int, rounds: Optional[int], detail: str, material: str, held: Sequence_[int],
                 patience_s: float) -> None:
        self._address = client.address
        self._obstacles = list(obstacles)
        self._frame_time_s = frame_time_s
        self._next = 0
        opening = coordinator_pb2.EnhanceOpen(
            coarse=_topology(garment), model=model, frame_time_s=frame_time_s, window=window, detail=_detail(detail),
            obstacles=[common_pb2.ObstacleShape(name=o.name, faces=o.faces.ravel(), capsules=o.capsules)
                       for o in self._obstacles])
        if material:
            opening.material.json = material
        if len(held) > 0:
            opening.handles.add().vertices.extend(int(vertex) for vertex in held)
        if rounds is not None:
            opening.subdivision_rounds = rounds
        self._vertices = len(garment.positions)
        self._client = client
        self._patience_s = patience_s
        self._kept: "collections.deque[coordinator_pb2.EnhanceRequest]" = collections.deque()  # since the checkpoint
        self._answered = 0  # of them
        if patience_s > 0:
            opening.checkpoint_interval = _CHECKPOINT_INTERVAL
        self._opening = opening
        self._start()
        opened = self._receive().opened
        self._opening.model = opened.model
        self._opening.detail = opened.detail
        self.fine = Mesh(np.array(opened.fine.rest_positions, np.float32).reshape(-1, 3),
                         np.array(opened.fine.faces, np.uint32).reshape(-1, 3),
                         np.array(opened.fine.uv, np.float32).reshape(-1, 2),
                         np.array(opened.fine.uv_faces, np.uint32).reshape(-1, 3))  #: of the answers
        self.feature_vertices = np.array(opened.feature_vertices, np.uint32)  #: (V_coarse,) inside the fine mesh
        self.model, self.device, self.precision = opened.model, opened.device, opened.precision
        self.window = int(opened.window)

    def enhance(self, frames: Iterable[npt.ArrayLike]) -> Iterator[EnhancedFrame]:
        """Sends coarse frames, each (V_coarse, 3), and gives the fine ones in order. `frames` is read as the window
        allows. A second call goes on in time. Raises FrameFailed for a frame that could not be made; whoever goes on
        after that calls again with the frames that follow it."""
        source = iter(frames)
        sent: List[int] = []
        ended = False
        while True:
            while not ended and len(sent) < self.window:
                try:
                    positions = next(source)
                except StopIteration:
                    ended = True
                    break
                sent.append(self._send(positions))
            if not sent:
                return
            answer = self._answer()
            index = sent.pop(0)
            if answer.HasField("error"):
                while sent:  # the answers of what is in flight
                    self._answer()
                    sent.pop()
                raise FrameFailed(_code_name(answer.error.code), f"frame {index}: {answer.error.message}")
            yield _frame(answer.frame)

    def enhance_all(self, frames: Iterable[npt.ArrayLike]) -> npt.NDArray[np.float32]:
        """The fine frames as one array (T, V_fine, 3)."""
        return np.stack([frame.positions for frame in self.enhance(frames)])

    def close(self) -> None:
        self._requests.put(None)
        self._call.cancel()

    def __enter__(self) -> "Session":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _send(self, positions: npt.ArrayLike) -> int:
        array = np.asarray(positions, np.float32)
        if array.shape != (self._vertices, 3):
            raise ValueError(f"frame {self._next}: shape {array.shape} instead of ({self._vertices}, 3)")
        index = self._next
        self._next += 1
        frame = coordinator_pb2.EnhanceFrame(
            coarse=common_pb2.Frame(index=index, time_s=index * self._frame_time_s, positions=array.ravel()),
            obstacles=[_obstacle(obstacle, index) for obstacle in self._obstacles])
        request = coordinator_pb2.EnhanceRequest(frame=frame)
        if self._patience_s > 0:
            self._kept.append(request)
            if len(self._kept) > _MOST_KEPT:  # the coordinator makes no checkpoints
                self._patience_s = 0
                self._kept.clear()
        self._requests.put(request)
        return index

    def _start(self) -> None:
        self._requests: "queue.SimpleQueue[Optional[coordinator_pb2.EnhanceRequest]]" = queue.SimpleQueue()
        self._call = self._client._stub.Enhance(iter(self._requests.get, None), metadata=self._client._metadata)
        self._requests.put(coordinator_pb2.EnhanceRequest(open=self._opening))

    def _receive(self) -> coordinator_pb2.EnhanceResponse:
        try:
            return next(self._call)
        except StopIteration:
            raise PleatError("UNAVAILABLE", f"{self._address}: the session was ended early") from None
        except grpc.RpcError as error:
            raise _error(self._address, error) from None

    def _answer(self) -> coordinator_pb2.EnhanceResponse:
        try:
            answer = self._receive()
        except PleatError as error:
            if error.code != "UNAVAILABLE" or self._patience_s <= 0:
                raise
            self._resume(error)
            return self._answer()
        self._answered += 1
        self._take(answer, self._answered)
        return answer

    def _take(self, answer: coordinator_pb2.EnhanceResponse, frames: int) -> None:
        """Forgets what lies before the checkpoint that comes with an answer: so many of the frames that are kept."""
        if not answer.checkpoint or self._patience_s <= 0:
            return
        self._opening.checkpoint = answer.checkpoint
        for _ in range(frames):
            self._kept.popleft()
        self._answered -= frames

    def _resume(self, cause: PleatError) -> None:
        """Opens the session again behind its checkpoint, and gets to where it was."""
        deadline = time.monotonic() + self._patience_s
        while True:
            try:
                self._requests.put(None)
                self._start()
                self._receive()
                for request in self._kept:
                    self._requests.put(request)
                newest: Optional[coordinator_pb2.EnhanceResponse] = None
                frames = 0
                for k in range(self._answered):
                    answer = self._receive()
                    if answer.checkpoint:
                        newest, frames = answer, k + 1
                if newest is not None:
                    self._take(newest, frames)
                return
            except PleatError as error:
                if error.code != "UNAVAILABLE":
                    raise
                if time.monotonic() > deadline:
                    self._patience_s = 0
                    raise cause from None
                time.sleep(0.1)


class Client:
    """A connection to a coordinator. Close it, or use it in a `with`."""

    def __init__(self, address: str, services: Optional[LocalServices] = None,
                 credentials: Optional[grpc.ChannelCredentials] = None, token: Optional[str] = None,
                 traceparent: Optional[str] = None) -> None:
        self.address = address
        self._metadata = [("authorization", f"Bearer {token}")] if token else []
        self._traceparent = traceparent
        if traceparent:
            self._metadata.append(("traceparent", traceparent))
        self._services = services
        options = [("grpc.max_receive_message_length", _MESSAGE_LIMIT), ("grpc.max_send_message_length", _MESSAGE_LIMIT)]
        self._channel = (grpc.secure_channel(address, credentials, options) if credentials is not None else
                         grpc.insecure_channel(address, options))
        self._stub = coordinator_pb2_grpc.CoordinatorStub(self._channel)

    def session(self, garment: Mesh, *, model: str = "", frame_time_s: float = 0.04,
                obstacles: Sequence_[Obstacle] = (), window: int = 0, rounds: Optional[int] = None,
                detail: str = "", material: "str | os.PathLike[str]" = "", held: Sequence_[int] = (),
                patience_s: float = 30) -> Session:
        """Opens a live session. model: a bundle's name, "" for the coordinator's default. window: frames in flight, 0
        for 4. rounds: of subdivision from the coarse to the fine mesh, None for the bundle's. detail: what makes the
        wrinkles, "network", "fold" (the fold step, which needs no bundle), "both" or "none" (smooth upsampling alone);
        "": a network where a bundle is named, else the fold step. For the fold step: material, a file in ARCSim's
        format, "" for Gray Interlock; held, coarse vertices that the cloth is held at all the time. patience_s: how
        long the coordinator may stay away in the middle of the session, which then goes on where it was."""
        text = pathlib.Path(material).read_text(encoding="utf-8") if material else ""
        return Session(self, garment, model, frame_time_s, obstacles, window, rounds, detail, text, held, patience_s)

    def run(self, scene: "str | os.PathLike[str]", out: "str | os.PathLike[str] | None" = None, *, model: str = "",
            frames: int = 0) -> Result:
        """Simulates and enhances a scene file by the command `pleat run`; its result. out: a folder, which keeps result
        and report; None: a new one below the temporary folder."""
        folder = pathlib.Path(out) if out is not None else pathlib.Path(tempfile.mkdtemp(prefix="pleat-run-"))
        program = self._services.program if self._services else os.environ.get("PLEAT_PROGRAM", "pleat")
        words = [program, "run", os.fspath(scene), "--out", os.fspath(folder), "--coordinator", self.address]
        words += ["--model", model] if model else []
        words += ["--frames", str(frames)] if frames else []
        environment = dict(os.environ, TRACEPARENT=self._traceparent) if self._traceparent else None
        done = subprocess.run(words, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
                              text=True, check=False)
        if done.returncode not in (0, 3):  # 3: intersections are left
            lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
            raise PleatError("INVALID_ARGUMENT" if done.returncode == 2 else "INTERNAL", lines[-1])
        return Result(folder / "result.h5")

    def jobs(self) -> List[Job]:
        """Newest first."""
        return [_job(job) for job in self._ask(self._stub.ListJobs, coordinator_pb2.ListJobsRequest()).jobs]

    def job(self, job_id: str) -> Job:
        return _job(self._ask(self._stub.GetJob, coordinator_pb2.GetJobRequest(id=job_id)))

    def cancel_job(self, job_id: str) -> Job:
        return _job(self._ask(self._stub.CancelJob, coordinator_pb2.CancelJobRequest(id=job_id)))

    def remove_job(self, job_id: str) -> Job:
        """One that has ended, with its files; as it was."""
        return _job(self._ask(self._stub.RemoveJob, coordinator_pb2.RemoveJobRequest(id=job_id)))

    def watch(self, job_id: str) -> Iterator[Job]:
        """The job as it changes, at least every second while it runs; the last is how it ended."""
        try:
            for event in self._stub.WatchJob(coordinator_pb2.WatchJobRequest(id=job_id), metadata=self._metadata):
                if event.HasField("progress"):
                    yield _job(event.progress)
        except grpc.RpcError as error:
            raise _error(self.address, error) from None

    def close(self) -> None:
        self._channel.close()
        if self._services:
            self._services.close()

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _ask(self, call: Callable[..., Any], request: Any) -> Any:
        try:
            return call(request, timeout=30, metadata=self._metadata)
        except grpc.RpcError as error:
            raise _error(self.address, error) from None


def connect(address: Optional[str] = None, *, program: Optional[str] = None, timeout_s: float = 30,
            credentials: Optional[grpc.ChannelCredentials] = None, token: Optional[str] = None,
            traceparent: Optional[str] = None) -> Client:
    """A connection to the coordinator at `address` (unix:PATH, HOST:PORT), or at $PLEAT_COORDINATOR. Without either
    `pleat up` is started here (program: which one) and ended by Client.close(). credentials: for other hosts; token: for a
    coordinator that wants one. traceparent: of the caller's W3C trace context, "00-TRACE-SPAN-FLAGS": log lines of all
    services have its trace id; None: the coordinator makes one for each call."""
    address = address or os.environ.get("PLEAT_COORDINATOR")
    services = None if address else LocalServices(program)
    client = Client(address or services.address, services, credentials, token, traceparent)  # type: ignore[union-attr]
    try:
        grpc.channel_ready_future(client._channel).result(timeout=timeout_s)
    except grpc.FutureTimeoutError:
        client.close()
        raise PleatError("UNAVAILABLE", f"{client.address}: nobody answers") from None
    return client


def _detail(name: str) -> int:
    known = {"": common_pb2.DETAIL_UNSPECIFIED, "network": common_pb2.DETAIL_NETWORK, "fold": common_pb2.DETAIL_FOLD,
             "both": common_pb2.DETAIL_BOTH, "none": common_pb2.DETAIL_NONE}
    if name not in known:
        raise ValueError(f"detail '{name}': there are network, fold, both and none")
    return int(known[name])


def _topology(mesh: Mesh) -> common_pb2.Topology:
    return common_pb2.Topology(rest_positions=mesh.positions.ravel(), faces=mesh.faces.ravel(), uv=mesh.uv.ravel(),
                               uv_faces=mesh.uv_faces.ravel())


def _obstacle(obstacle: Obstacle, index: int) -> common_pb2.ObstacleFrame:
    state = obstacle.frame(index)
    message = common_pb2.ObstacleFrame(name=obstacle.name)
    if state.positions is not None:
        message.positions.extend(np.asarray(state.positions, np.float32).ravel())
    elif state.capsule_ends is not None and state.capsule_radii is not None:
        message.capsule_ends.extend(state.capsule_ends.ravel())
        message.capsule_radii.extend(state.capsule_radii.ravel())
    else:
        message.center.extend(state.center)
        message.radius = state.radius
    return message


def _frame(message: coordinator_pb2.EnhancedFrame) -> EnhancedFrame:
    stages: Dict[str, float] = {}
    for time in message.stage_times:
        stages[time.stage] = stages.get(time.stage, 0.0) + time.ms
    positions = np.array(message.fine.positions, np.float32).reshape(-1, 3)
    return EnhancedFrame(int(message.fine.index), message.fine.time_s, positions, message.report, stages)


def _job(message: coordinator_pb2.Job) -> Job:
    state = coordinator_pb2.Job.State.Name(message.state).replace("STATE_", "").lower()
    return Job(message.id, message.scene_name, state, message.frames, message.frames_complete, message.error,
               message.result_path, message.owner, message.trace_id)


def _code_name(code: int) -> str:
    for status in grpc.StatusCode:
        if status.value[0] == code:
            return str(status.name)
    return "UNKNOWN"


def _error(address: str, error: grpc.RpcError) -> PleatError:
    return PleatError(error.code().name, f"{address}: {error.details()}")
