"""What crash.py and soak.py share: stubs made from proto/, `pleat up` as a child, a scene, the bits of a result.
Debian's python3-grpcio, python3-h5py, python3-numpy, protobuf-compiler, protobuf-compiler-grpc."""

import atexit
import hashlib
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

SOURCE = pathlib.Path(__file__).resolve().parents[2]
WORK = pathlib.Path(tempfile.mkdtemp(prefix="pleat-reliability-"))
atexit.register(shutil.rmtree, WORK, True)

try:
    import grpc
    import h5py
    import numpy
except ImportError as missing:
    print(f"skipped: {missing} (Debian: python3-grpcio python3-h5py python3-numpy)")
    sys.exit(77)
if not shutil.which("protoc") or not shutil.which("grpc_python_plugin"):
    print("skipped: no protoc or grpc_python_plugin (Debian: protobuf-compiler protobuf-compiler-grpc)")
    sys.exit(77)
subprocess.run(["protoc", f"-I{SOURCE}/proto", f"--python_out={WORK}", f"--grpc_python_out={WORK}",
                f"--plugin=protoc-gen-grpc_python={shutil.which('grpc_python_plugin')}",
                *map(str, (SOURCE / "proto/pleat/v1").glob("*.proto"))], check=True)
sys.path.insert(0, str(WORK))
from pleat.v1 import common_pb2, coordinator_pb2, coordinator_pb2_grpc, scene_pb2  # noqa: E402

MAX_MESSAGE = 64 << 20


def services_of(launcher):
    """Name -> process id of the services that a `pleat up` or `pleat run` has started."""
    found = {}
    for entry in pathlib.Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            stat = (entry / "stat").read_text()
            state, parent = stat[stat.rindex(")") + 2:].split()[:2]
            name = os.path.basename((entry / "cmdline").read_bytes().split(b"\0")[0].decode())
        except (OSError, ValueError):
            continue
        if int(parent) == launcher and state != "Z" and name.startswith("pleat-"):
            found[name.removeprefix("pleat-")] = int(entry.name)
    return found


def resident_mb(process):
    """Memory of a process in MB; 0 if it has gone."""
    try:
        lines = pathlib.Path(f"/proc/{process}/status").read_text().splitlines()
        return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS"))
    except (OSError, StopIteration):
        return 0.0


def channel_to(address):
    """A connection of its own."""
    return grpc.insecure_channel(address, options=[("grpc.max_receive_message_length", MAX_MESSAGE),
                                                   ("grpc.use_local_subchannel_pool", 1)])


class Up:
    """`pleat up`; leaves nothing behind."""

    def __init__(self, pleat, data):
        self.process = subprocess.Popen([pleat, "up", "--data", data], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                                        text=True)
        atexit.register(self.kill)
        self.address = next((line.split()[1] for line in self.process.stdout if line.startswith("ready ")), None)
        if self.address is None:
            raise RuntimeError(f"`pleat up` ended with exit code {self.process.wait()}; logs: {data}/logs")

    def services(self):
        return services_of(self.process.pid)

    def channel(self):
        return channel_to(self.address)

    def coordinator(self):
        return coordinator_pb2_grpc.CoordinatorStub(self.channel())

    def kill(self):
        self.process.kill()
        self.process.wait()
        atexit.unregister(self.kill)

    def stop(self):
        self.process.terminate()
        code = self.process.wait(60)
        atexit.unregister(self.kill)
        return code


def garment(name):
    """deploy/garments/NAME.obj as a message."""
    positions, uv, faces, uv_faces = [], [], [], []
    for line in (SOURCE / f"deploy/garments/{name}.obj").read_text().splitlines():
        key, *values = line.split() or [""]
        if key == "v":
            positions += map(float, values[:3])
        elif key == "vt":
            uv += map(float, values[:2])
        elif key == "f":
            corners = [[int(index) - 1 for index in value.split("/")[:2]] for value in values]
            for second, third in zip(corners[1:], corners[2:]):
                for position, texture in (corners[0], second, third):
                    faces.append(position)
                    uv_faces.append(texture)
    return common_pb2.Topology(rest_positions=positions, faces=faces, uv=uv, uv_faces=uv_faces)


def scene(name, garment_name, frames, seed, perturbation_m, held):
    """A scene without files: a garment that hangs by some vertices."""
    result = scene_pb2.Scene(name=name, frames=frames, seed=seed, perturbation_m=perturbation_m,
                             garment_mesh=garment(garment_name),
                             material_json=(SOURCE / "deploy/materials/gray-interlock.json").read_text())
    result.handles.add().vertices.extend(held)
    return result


def falling_cloth(frames, seed):
    """The tablecloth, held by one vertex."""
    return scene("draping", "tablecloth", frames, seed, 0.001, [77])


def falling_sheet(frames, seed):
    """The coarse sheet of 81 vertices, held by two corners."""
    return scene("sheet", "sheet", frames, seed, 0.02, [0, 72])


def bits(result):
    """A hash of everything that was simulated and enhanced."""
    digest = hashlib.sha256()
    with h5py.File(result) as file:
        for name in ("coarse/positions", "enhanced/positions", "fine/positions"):
            if name in file:
                digest.update(numpy.ascontiguousarray(file[name][:]).tobytes())
    return digest.hexdigest()[:16]
