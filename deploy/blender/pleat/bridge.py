# SPDX-License-Identifier: GPL-3.0-or-later
"""The process `pleat bridge`, which this add-on owns: JSON lines to it and from it (docs/cli.md of Pleat)."""

import json
import os
import queue
import shutil
import subprocess
import tempfile
import threading
import time


class BridgeError(RuntimeError):
    """What Pleat says, or why it does not answer; one line."""


def find_program(named=""):
    """The program `pleat`: as named, $PLEAT_PROGRAM, or on the PATH."""
    program = named or os.environ.get("PLEAT_PROGRAM") or shutil.which("pleat")
    if not program or not shutil.which(program):
        raise BridgeError(f"no program {program or 'pleat'}: name it in the add-on's preferences")
    return program


class Bridge:
    """One process. Answers come by a thread; everything else belongs to one thread."""

    def __init__(self, program="", detail="fold", model=""):
        words = [find_program(program), "bridge", "--detail", detail]
        if model:
            words += ["--model", model]
        self._log = tempfile.TemporaryFile()
        self._answers = queue.Queue()
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._log, text=True)
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self._process.stdout:
            self._answers.put(json.loads(line))
        self._answers.put(None)

    def send(self, request):
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
        except OSError:
            raise BridgeError(self._last_words()) from None

    def poll(self, timeout=0.0):
        """The next answer as (kind, values), or None. Raises BridgeError for an error, or if the process ended."""
        try:
            answer = self._answers.get(timeout=timeout) if timeout > 0 else self._answers.get_nowait()
        except queue.Empty:
            return None
        if answer is None:
            raise BridgeError(self._last_words())
        kind, values = next(iter(answer.items()))
        if kind == "error":
            raise BridgeError(values["message"])
        return kind, values

    def wait(self, kind, timeout=120.0):
        """The values of the next answer of this kind; others are dropped."""
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            answer = self.poll(0.1)
            if answer and answer[0] == kind:
                return answer[1]
        raise BridgeError(f"pleat did not answer within {timeout:.0f} s")

    def alive(self):
        return self._process.poll() is None

    def close(self):
        if self.alive():
            try:
                self._process.stdin.close()
            except OSError:
                pass
            self._process.terminate()
            try:
                self._process.wait(20)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._log.close()

    def _last_words(self):
        self._process.wait()
        self._log.seek(0)
        lines = self._log.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"pleat ended with exit code {self._process.returncode}"
