"""Processes that may use a share of a core, as cgroups limit it (cpu controller of version 1 or 2, as root)."""

import atexit
import os
import pathlib
import signal
import subprocess
import time

PERIOD_US = 100_000  # in shorter ones a process finds its caches cold too often
ROOT = pathlib.Path("/sys/fs/cgroup")


class Unavailable(Exception):
    pass


def _hierarchy():
    for folder, version in ((ROOT / "cpu", 1), (ROOT / "cpu,cpuacct", 1), (ROOT, 2)):
        if version == 1 and (folder / "cpu.cfs_quota_us").exists() or version == 2 and (folder / "cgroup.controllers").exists():
            return folder, version
    raise Unavailable("no cgroup hierarchy with a cpu controller under /sys/fs/cgroup")


class Share:
    """A group of processes that together get `cores` of a core; removed at exit, when they have ended."""

    made = 0

    def __init__(self, cores):
        folder, version = _hierarchy()
        Share.made += 1
        self.folder = folder / f"pleat-scale-{os.getpid()}-{Share.made}"
        quota = max(1000, round(cores * PERIOD_US))  # the kernel's least is a millisecond
        try:
            if version == 2:
                (folder / "cgroup.subtree_control").write_text("+cpu")
            self.folder.mkdir()
            if version == 2:
                (self.folder / "cpu.max").write_text(f"{quota} {PERIOD_US}")
            else:
                (self.folder / "cpu.cfs_period_us").write_text(str(PERIOD_US))
                (self.folder / "cpu.cfs_quota_us").write_text(str(quota))
        except OSError as error:
            raise Unavailable(f"{error.filename}: {error.strerror}; limiting processors needs root and the cpu controller")
        atexit.register(self.remove)

    def enter(self):
        """Moves the calling process and all that it starts in here."""
        (self.folder / "cgroup.procs").write_text(str(os.getpid()))

    def remove(self):
        for _ in range(100):
            try:
                self.folder.rmdir()
                return
            except FileNotFoundError:
                return
            except OSError:
                time.sleep(0.02)  # its processes are ending


def start(words, share=None, **options):
    """A child that dies with this program."""
    child = subprocess.Popen([str(word) for word in words], preexec_fn=share.enter if share else None, **options)
    atexit.register(stop, child)
    return child


def stop(child):
    if child.poll() is None:
        child.send_signal(signal.SIGTERM)
        try:
            child.wait(10)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()


def cpu_seconds(child):
    """Processor time of a child and of its children that have ended."""
    stat = pathlib.Path(f"/proc/{child.pid}/stat").read_text()
    fields = stat[stat.rindex(")") + 2:].split()
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
