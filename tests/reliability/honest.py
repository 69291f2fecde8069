#!/usr/bin/env python3
"""Live sessions that send frames at a fixed rate, begin anew when they have ended, and check every answer.

    honest.py ADDRESS SESSIONS RATE

Prints `answered SECONDS` for a frame (from sending it to having its answer), or a line that says what went wrong. Goes on until it
is killed."""

import queue
import random
import sys
import threading
import time

import harness
from harness import common_pb2, coordinator_pb2, coordinator_pb2_grpc

ADDRESS, RATE = sys.argv[1], float(sys.argv[3])
CLOTH = harness.garment("tablecloth")


def say(line):
    sys.stdout.write(line + "\n")  # at once, whatever other threads say
    sys.stdout.flush()


def session():
    requests = queue.Queue()
    requests.put(coordinator_pb2.EnhanceRequest(open=coordinator_pb2.EnhanceOpen(coarse=CLOTH)))
    with harness.channel_to(ADDRESS) as channel:
        answers = coordinator_pb2_grpc.CoordinatorStub(channel).Enhance(iter(requests.get, None))
        if not next(answers).HasField("opened"):
            raise RuntimeError("no `opened`")
        due = time.monotonic() + random.random() / RATE
        for index in range(random.randrange(50, 500)):
            time.sleep(max(0, due - time.monotonic()))
            frame = common_pb2.Frame(index=index, positions=CLOTH.rest_positions)
            request = coordinator_pb2.EnhanceRequest(frame=coordinator_pb2.EnhanceFrame(coarse=frame))
            sent = time.monotonic()
            requests.put(request)
            answer = next(answers)
            took = time.monotonic() - sent
            if answer.frame.fine.index != index or answer.HasField("error"):
                raise RuntimeError(f"frame {index} was answered by {answer.error or answer.frame.fine.index}")
            say(f"answered {took:.6f}")
            due = max(due + 1 / RATE, time.monotonic())
        requests.put(None)
        for _ in answers:
            raise RuntimeError("an answer too many")


def client(number):
    while True:
        try:
            session()
        except Exception as error:  # whatever it is, an honest client met it
            say(f"session {number}: {error}".replace("\n", " "))
            time.sleep(1)


for number in range(int(sys.argv[2])):
    threading.Thread(target=client, args=[number], daemon=True).start()
threading.Event().wait()
