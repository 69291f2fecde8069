"""A Slurm of several nodes on this host alone: its own authentication, ports and folder, and nothing of the machine's."""

import os
import pathlib
import shutil
import signal
import socket
import subprocess
import time

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "scontrol", "squeue", "scancel")
SEARCHED = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/sbin"])

CONFIGURATION = """
ClusterName=pleat
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={control_port}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
CredType=cred/munge
AuthInfo=socket={folder}/munge.socket,cred_expire=5
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool-%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd-%n.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd-%n.log
MpiDefault=none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SlurmdParameters=config_overrides
SchedulerParameters=sched_interval=1
SlurmdTimeout=10
KillWait=10
ReturnToService=2
JobRequeue=1
{nodes}
PartitionName=all Nodes={names} Default=YES MaxTime=INFINITE State=UP
"""


def missing_programs():
    return [name for name in PROGRAMS if shutil.which(name, path=SEARCHED) is None]


def free_ports(count):
    """Ports that nobody has at the moment."""
    sockets = [socket.socket() for _ in range(count)]
    for each in sockets:
        each.bind(("127.0.0.1", 0))
    ports = [each.getsockname()[1] for each in sockets]
    for each in sockets:
        each.close()
    return ports


def processes_of(mark):
    """Numbers of the processes in whose environment the mark stands."""
    found = []
    for process in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            variables = (process / "environ").read_bytes().split(b"\0")
        except OSError:
            continue
        if mark.encode() in variables:
            found.append(int(process.name))
    return found


def step_manager(number):
    """The slurmstepd that started the process, if one did."""
    try:
        parent = int(pathlib.Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[1])
        command = pathlib.Path(f"/proc/{parent}/cmdline").read_bytes()
    except OSError:
        return None
    return parent if command.startswith(b"slurmstepd") else None


class Cluster:
    """Use as a context. `folder` must have a short path; jobs are those of this user."""

    def __init__(self, folder, nodes):
        self.folder = pathlib.Path(folder)
        self.names = [f"n{i + 1}" for i in range(nodes)]
        self.daemons = {}
        self.environment = {**os.environ, "PATH": SEARCHED, "SLURM_CONF": str(self.folder / "slurm.conf")}

    def __enter__(self):
        try:
            self.start_all()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_):
        for number in processes_of(f"SLURM_CONF={self.folder}/slurm.conf"):
            if number != os.getpid():
                self.kill(number)
        for daemon in self.daemons.values():
            daemon.kill()
            daemon.wait()

    @staticmethod
    def kill(number):
        try:
            os.kill(number, signal.SIGKILL)
        except ProcessLookupError:
            pass

    def start_all(self):
        key = self.folder / "munge.key"
        key.write_bytes(os.urandom(128))
        key.chmod(0o600)
        self.folder.chmod(0o755)  # munged refuses sockets that others can't reach
        self.start("munged", "--foreground", f"--socket={self.folder}/munge.socket", f"--key-file={key}",
                   f"--log-file={self.folder}/munged.log", f"--pid-file={self.folder}/munged.pid",
                   f"--seed-file={self.folder}/munged.seed", "--num-threads=2", "--force")
        (self.folder / "state").mkdir()
        control_port, *ports = free_ports(1 + len(self.names))
        host = socket.gethostname().split(".")[0]
        nodes = "\n".join(f"NodeName={name} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} CPUs=1 RealMemory=8192 State=UNKNOWN"
                          for name, port in zip(self.names, ports))
        (self.folder / "slurm.conf").write_text(CONFIGURATION.format(
            host=host, control_port=control_port, folder=self.folder, nodes=nodes, names=",".join(self.names),
            user=subprocess.run(["id", "-un"], capture_output=True, text=True, check=True).stdout.strip()))
        self.wait_until(lambda: (self.folder / "munge.socket").exists(), "munged does not start")
        self.start("slurmctld", "-D")
        for name in self.names:
            self.start_node(name)
        self.wait_until(lambda: self.states() == ["idle"] * len(self.names), "the nodes do not come up")

    def start(self, program, *words, name=None):
        with open(self.folder / f"{name or program}.out", "a") as output:
            self.daemons[name or program] = subprocess.Popen([shutil.which(program, path=SEARCHED), *words], stdout=output,
                                                             stderr=subprocess.STDOUT, env=self.environment)

    def start_node(self, name):
        self.start("slurmd", "-D", "-N", name, name=name)

    def states(self):
        listing = self.run("sinfo", "--noheader", "--Node", "--format=%t", check=False).stdout.split()
        return [state.rstrip("*") for state in listing]

    def run(self, *words, check=True):
        done = subprocess.run([str(word) for word in words], env=self.environment, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, text=True)
        if check and done.returncode != 0:
            raise RuntimeError(f"{words}: {done.stdout}")
        return done

    def submit(self, *words):
        """The number of the job."""
        return self.run("sbatch", "--parsable", *words).stdout.strip().split(";")[0]

    def jobs(self):
        """Task -> (state, node) of what has not left the queue."""
        listing = self.run("squeue", "--noheader", "--array", "--format=%i %T %N").stdout.splitlines()
        return {line.split()[0]: (line.split()[1], (line.split() + [""])[2]) for line in listing}

    def crash_node(self, name):
        """As if its power was cut: the daemon, its step managers, which would report the end, and all that they started."""
        daemon = self.daemons.pop(name)
        daemon.kill()
        started = processes_of(f"SLURMD_NODENAME={name}")
        for number in {*filter(None, map(step_manager, started)), *started}:
            self.kill(number)
        daemon.wait()

    @staticmethod
    def wait_until(condition, message, seconds=120):
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                raise RuntimeError(message)
            time.sleep(0.2)
