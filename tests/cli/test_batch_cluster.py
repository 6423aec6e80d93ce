"""spxbatch as tasks of a job array: under Slurm, whose daemons this test starts and stops, and under GNU parallel."""

import getpass
import os
import pathlib
import shutil
import socket
import subprocess
import tempfile
import time

import pytest

from conftest import BIN, run_tool, write_image
from test_batch import batch, noise, outputs, rows


@pytest.fixture
def library(tmp_path):
    src = tmp_path / "src"
    (src / "a b").mkdir(parents=True)
    for i in range(9):
        write_image(src / "a b" / f"t{i}.png", noise(i, 40, 30))
    write_image(src / "again.png", noise(3, 40, 30))
    write_image(src / "brick_roughness.png", noise(20))
    (src / "bad.png").write_bytes(b"no picture")
    batch(src, tmp_path / "one", check=2)
    return src


def check_joined(library, tmp_path, dst):
    joined = run_tool("spxbatch", "merge", dst, "--json", "-", check=0).json()
    assert joined["shards"] == 3 and joined["missing"] == []
    assert outputs(dst) == outputs(tmp_path / "one")
    assert rows(dst) == rows(tmp_path / "one")
    assert batch(library, dst, check=2)["converted"] == 0


class Cluster:
    """munged, slurmctld and slurmd of this user on one machine, in a folder of their own."""

    def __init__(self):
        missing = [p for p in ("munged", "slurmctld", "slurmd", "sbatch", "sinfo") if not shutil.which(p, path=self.path())]
        if missing:
            pytest.skip(f"not installed: {', '.join(missing)} (packages slurm-wlm, munge)")
        # A socket's path must be short, and munge wants folders that nobody else can write.
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="spxslurm", dir="/tmp"))
        self.folder.chmod(0o755)
        self.processes = []
        self.env = {**os.environ, "PATH": self.path(), "SLURM_CONF": str(self.folder / "slurm.conf")}

    @staticmethod
    def path():
        return os.environ.get("PATH", "") + ":/usr/sbin:/sbin"

    def start(self, name, *command):
        log = open(self.folder / f"{name}.log", "wb")
        self.processes.append(subprocess.Popen([str(c) for c in command], env=self.env, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                                               start_new_session=True))

    def __enter__(self):
        f = self.folder
        key, munge, host = f / "key", f / "munge.socket", socket.gethostname().split(".")[0]
        key.write_bytes(os.urandom(128))
        key.chmod(0o600)
        for name in ("state", "spool"):
            (f / name).mkdir()
        with socket.socket() as a, socket.socket() as b:
            a.bind(("127.0.0.1", 0))
            b.bind(("127.0.0.1", 0))
            ports = a.getsockname()[1], b.getsockname()[1]
        # Three tasks at once whatever the machine has, no accounting, no cgroups.
        (f / "slurm.conf").write_text(f"""ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
AuthType=auth/munge
AuthInfo=socket={munge}
SlurmUser={getpass.getuser()}
SlurmdUser={getpass.getuser()}
StateSaveLocation={f}/state
SlurmdSpoolDir={f}/spool
SlurmctldPidFile={f}/slurmctld.pid
SlurmdPidFile={f}/slurmd.pid
SlurmdParameters=config_overrides
ProctrackType=proctrack/pgid
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
ReturnToService=2
SchedulerParameters=batch_sched_delay=0,sched_min_interval=0
NodeName={host} NodeAddr=127.0.0.1 CPUs=4
PartitionName=test Nodes={host} Default=YES MaxTime=10
""")
        self.start("munged", "munged", "--foreground", "--force", f"--socket={munge}", f"--key-file={key}", f"--pid-file={f}/munged.pid",
                   f"--log-file={f}/munge.messages", f"--seed-file={f}/munge.seed")
        self.wait(munge.exists, "munged")
        self.start("slurmctld", "slurmctld", "-D", "-f", f / "slurm.conf")
        self.start("slurmd", "slurmd", "-D", "-f", f / "slurm.conf", "-N", host)
        self.wait(lambda: "idle" in self.run("sinfo", "-h", "-o", "%T").stdout, "slurmd")
        return self

    def wait(self, condition, what, seconds=30):
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end or any(p.poll() is not None for p in self.processes):
                said = "; ".join(f"{p.name}: {p.read_text(errors='replace')[-300:]}" for p in sorted(self.folder.glob("*.log")))
                self.__exit__()
                pytest.skip(f"{what} does not start here: {said}")
            time.sleep(0.1)

    def run(self, *command):
        return subprocess.run([str(c) for c in command], env=self.env, cwd=self.folder, capture_output=True, text=True, timeout=30)

    def __exit__(self, *_):
        for process in reversed(self.processes):
            process.terminate()
            try:
                process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)


def test_slurm_array(library, tmp_path):
    dst = tmp_path / "dst"
    with Cluster() as cluster:
        script = tmp_path / "job.sh"
        script.write_text("#!/bin/sh\n"
                          f"'{BIN}/spxbatch' '{library}' '{dst}' --shard \"$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT\"\n"
                          f"echo $? > '{tmp_path}'/ended.$SLURM_ARRAY_TASK_ID\n")
        submitted = cluster.run("sbatch", "--array=1-3", f"--output={tmp_path}/task-%a.log", script)
        assert submitted.returncode == 0, submitted.stderr
        codes = [tmp_path / f"ended.{i}" for i in (1, 2, 3)]
        end = time.monotonic() + 90
        while not all(c.exists() and c.read_text() for c in codes):
            assert time.monotonic() < end, cluster.run("squeue").stdout + (cluster.folder / "slurmd.log").read_text()
            time.sleep(0.1)
    # One task met the broken file, and says so by its code.
    assert sorted(int(c.read_text()) for c in codes) == [0, 0, 2]
    assert all("converted" in (tmp_path / f"task-{i}.log").read_text() for i in (1, 2, 3))
    check_joined(library, tmp_path, dst)


def test_gnu_parallel(library, tmp_path):
    found = shutil.which("parallel")
    if not found or "GNU parallel" not in subprocess.run([found, "--version"], capture_output=True, text=True).stdout:
        pytest.skip("GNU parallel is not installed (package parallel)")
    dst = tmp_path / "dst"
    finished = subprocess.run([found, "--will-cite", "-j", "3", BIN / "spxbatch", library, dst, "--quiet", "--shard", "{}/3", ":::", "1", "2", "3"],
                              stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=120, env={**os.environ, "HOME": str(tmp_path)})
    # The number of tasks that failed: the one with the broken file.
    assert finished.returncode == 1, finished.stderr
    check_joined(library, tmp_path, dst)
