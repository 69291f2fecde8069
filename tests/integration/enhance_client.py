#!/usr/bin/env python3
"""A complete client of Coordinator.Enhance in another language: coarse frames in, refined fine frames out, live.

    enhance_client.py ADDRESS REST.obj [--frames N] [--model BUNDLE] [--out FINE.obj]

The frames are a wave that runs through the rest mesh. Needs Debian's python3-grpcio, protobuf-compiler and
protobuf-compiler-grpc; the stubs are made from proto/ at start. Exit code 0: every frame came back, in order and free of self-intersections.
"""

import argparse
import importlib
import math
import pathlib
import queue
import shutil
import subprocess
import sys
import tempfile

import grpc

PROTO = pathlib.Path(__file__).resolve().parents[2] / "proto"
MESSAGE_LIMIT = 64 * 1024 * 1024
FRAME_TIME = 0.04


def load_stubs(folder):
    """Compiles proto/pleat/v1/*.proto into `folder` and imports what this client needs."""
    files = sorted(str(path) for path in (PROTO / "pleat/v1").glob("*.proto"))
    # Debian's python3-grpc-tools holds a protoc from before proto3's `optional`; its protobuf-compiler knows it.
    subprocess.run(["protoc", f"-I{PROTO}", f"--python_out={folder}", f"--grpc_python_out={folder}",
                    f"--plugin=protoc-gen-grpc_python={shutil.which('grpc_python_plugin')}", *files], check=True)
    sys.path.insert(0, str(folder))
    return [importlib.import_module(f"pleat.v1.{name}")
            for name in ("common_pb2", "coordinator_pb2", "coordinator_pb2_grpc")]


def read_obj(path):
    """Rest positions, material coordinates and their faces, flat as on the wire. Polygons are cut into fans."""
    positions, uv, faces, uv_faces = [], [], [], []
    for line in pathlib.Path(path).read_text().splitlines():
        key, *values = line.split() or [""]
        if key == "v":
            positions += map(float, values[:3])
        elif key == "vt":
            uv += map(float, values[:2])
        elif key == "f":
            corners = [[int(index) - 1 for index in value.split("/")[:2]] for value in values]
            for second, third in zip(corners[1:], corners[2:]):
                for corner in (corners[0], second, third):
                    faces.append(corner[0])
                    uv_faces.append(corner[1])
    return positions, uv, faces, uv_faces


def wave(rest, index):
    """Positions of a frame: a wave along x, 2 cm high."""
    time = index * FRAME_TIME
    positions = list(rest)
    for v in range(0, len(rest), 3):
        positions[v + 1] += 0.02 * math.sin(6 * rest[v] + 4 * time)
    return positions


def enhance(address, rest_file, frames, model, out):
    with tempfile.TemporaryDirectory() as folder:
        common, messages, services = load_stubs(folder)
    rest, uv, faces, uv_faces = read_obj(rest_file)
    topology = common.Topology(rest_positions=rest, faces=faces, uv=uv, uv_faces=uv_faces)
    channel = grpc.insecure_channel(address, options=[("grpc.max_receive_message_length", MESSAGE_LIMIT),
                                                      ("grpc.max_send_message_length", MESSAGE_LIMIT)])
    requests = queue.Queue()
    answers = services.CoordinatorStub(channel).Enhance(iter(requests.get, None))

    requests.put(messages.EnhanceRequest(
        open=messages.EnhanceOpen(coarse=topology, model=model, frame_time_s=FRAME_TIME)))
    opened = next(answers).opened
    fine_values = len(opened.fine.rest_positions)
    print(f"session: {len(rest) // 3} -> {fine_values // 3} vertices, bundle {opened.model} on {opened.device} "
          f"in {opened.precision}, window {opened.window}", flush=True)

    def send(index):
        # Velocities are left out: the coordinator fills them.
        frame = common.Frame(index=index, time_s=index * FRAME_TIME, positions=wave(rest, index))
        requests.put(messages.EnhanceRequest(frame=messages.EnhanceFrame(coarse=frame)))

    for index in range(min(opened.window, frames)):
        send(index)
    fine = []
    for index in range(frames):
        answer = next(answers)
        if answer.HasField("error"):
            raise RuntimeError(f"frame {answer.error.index}: {answer.error.message}")
        fine, report = answer.frame.fine, answer.frame.report
        times = ", ".join(f"{time.stage} {time.ms:.1f} ms" for time in answer.frame.stage_times)
        print(f"frame {fine.index}: {times}", flush=True)
        if fine.index != index or len(fine.positions) != fine_values:
            raise RuntimeError(f"frame {index}: got frame {fine.index} with {len(fine.positions) // 3} vertices")
        if not all(map(math.isfinite, fine.positions)):
            raise RuntimeError(f"frame {index}: a position is not finite")
        if report.self_intersections_after or report.penetrations_after:
            raise RuntimeError(f"frame {index}: {report.self_intersections_after} self-intersections are left")
        if index + opened.window < frames:
            send(index + opened.window)
    requests.put(None)
    if next(answers, None) is not None:
        raise RuntimeError("an answer too many")
    channel.close()

    if out and frames:
        with open(out, "w") as file:
            for v in range(0, fine_values, 3):
                file.write("v {:.7g} {:.7g} {:.7g}\n".format(*fine.positions[v:v + 3]))
            for f in range(0, len(opened.fine.faces), 3):
                file.write("f {} {} {}\n".format(*(index + 1 for index in opened.fine.faces[f:f + 3])))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("address", help="of the coordinator: unix:PATH or HOST:PORT")
    parser.add_argument("rest", help="OBJ file of the coarse garment, with material coordinates")
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--model", default="", help="bundle; default: the service's")
    parser.add_argument("--out", help="write the last fine frame here")
    options = parser.parse_args()
    try:
        enhance(options.address, options.rest, options.frames, options.model, options.out)
    except (OSError, RuntimeError, subprocess.CalledProcessError) as error:
        sys.exit(f"enhance_client: {error}")
    except grpc.RpcError as error:
        sys.exit(f"enhance_client: {options.address}: {error.code().name}: {error.details()}")
    print(f"{options.frames} frames enhanced")


if __name__ == "__main__":
    main()
