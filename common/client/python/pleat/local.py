"""A coordinator with its services on this host, for programs that are given none."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from typing import Optional


class LocalServices:
    """Runs `pleat up` until close(). The services end with this process, however it ends."""

    def __init__(self, program: Optional[str] = None) -> None:
        found = program or os.environ.get("PLEAT_PROGRAM") or shutil.which("pleat")
        if not found:
            raise FileNotFoundError("no `pleat` on the PATH; name it with $PLEAT_PROGRAM or pleat.connect(program=...)")
        self.program = found
        self._folder = tempfile.TemporaryDirectory(prefix="pleat-python-")
        with open(os.path.join(self._folder.name, "up.log"), "w+", encoding="utf-8") as log:
            self._process = subprocess.Popen([found, "up", "--data", self._folder.name], stdin=subprocess.DEVNULL,
                                             stdout=subprocess.PIPE, stderr=log, text=True)
            assert self._process.stdout is not None
            self.address = ""
            for line in self._process.stdout:
                if line.startswith("ready "):
                    self.address = line.split()[1]
                    break
            if not self.address:
                self._process.wait()
                log.seek(0)
                cause = (log.read().strip().splitlines() or ["no message"])[-1]
                self._folder.cleanup()
                raise RuntimeError(f"{found} up: {cause}")

    def close(self) -> None:
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(30)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._folder.cleanup()
