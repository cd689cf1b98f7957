"""Slurm on the nodes of a test bed, with separate daemons and a shared checkout."""

import re
import shutil
from pathlib import Path

from bed import SEARCHED, USER, VENV, Bed, wait_until
from checkout import copy_checkout, lend_environment

CONFIGURATION = """
ClusterName=bed
SlurmctldHost={head}
SlurmUser=root
AuthType=auth/munge
StateSaveLocation=/var/spool/slurmctld
SlurmdSpoolDir=/var/spool/slurmd
SlurmctldPidFile=/run/slurmctld.pid
SlurmdPidFile=/run/slurmd.pid
SlurmdParameters=config_overrides
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
MpiDefault=none
ReturnToService=2
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
SchedulerParameters=sched_interval=5
NodeName={nodes} CPUs=16 RealMemory=40000
PartitionName=batch Nodes=ALL Default=YES PriorityTier=1 PreemptMode=REQUEUE GraceTime=90
PartitionName=urgent Nodes=ALL PriorityTier=10 PreemptMode=OFF
"""
"""Configuration of Slurm, in which nodes have the cores that the batch script requests."""

DAEMONS = ("munged", "slurmctld", "slurmd")
CHECKOUT = "/shared/checkout"


def missing_daemons() -> str | None:
    """Return the reason why this machine cannot run Slurm, or None."""
    lacking = [each for each in DAEMONS if shutil.which(each, path=SEARCHED) is None]
    return f"needs {', '.join(lacking)} (Debian's slurm-wlm and munge)" if lacking else None


class Slurm:
    """Slurm cluster of all nodes of a bed, with the first as its controller."""

    def __init__(self, bed: Bed, wheel: Path) -> None:
        names = list(bed.nodes)
        self.shared, self.nodes = bed.shared, list(bed.nodes.values())
        checkout = bed.shared / "checkout"
        copy_checkout(checkout, wheel)
        (checkout / ".venv").symlink_to(VENV)
        text = CONFIGURATION.format(head=names[0], nodes=",".join(names))
        for node in bed.on(*names):
            lend_environment(node)
            node.run(f"{VENV}/bin/pip install --quiet --no-deps --force-reinstall {CHECKOUT}/dist/*.whl")
            node.write("/etc/slurm/slurm.conf", text)
            node.run("install -d -o munge -g munge /run/munge && runuser -u munge munged", user="root")
            node.write("/etc/slurm/cgroup.conf", "CgroupPlugin=cgroup/v1\n")
            node.run("mount -t tmpfs tmpfs /sys/fs/cgroup", user="root")  # required by Slurm, but not used
            node.run("mkdir -p /var/spool/slurmctld /var/spool/slurmd /var/log/slurm", user="root")
        self._head = bed.nodes[names[0]]
        self._head.run(f"chown -R {USER}: {CHECKOUT} && slurmctld", user="root")
        for node in bed.nodes.values():
            node.run("slurmd", user="root")
        ready = [f"{len(names)}/idle"]
        wait_until(lambda: self._head.run("sinfo -h -o %D/%T", shown=False).split() == ready, 60)

    def run(self, command: str, code: int | None = 0) -> str:
        """Run a command in the checkout, as a user on the first node; see `Node.run`."""
        return self._head.run(f"cd {CHECKOUT}; {command}", code=code)

    def submit(self, arguments: str) -> int:
        """Submit the shipped batch script; return the number of the job."""
        return int(self.run(f"sbatch --parsable {arguments}"))

    def state(self, job: int) -> str:
        """Return the state and exit code of a job, such as "COMPLETED 0:0"."""
        shown = self._head.run(f"scontrol show job {job}", shown=False)
        found = {key: re.search(rf"\b{key}=(\S+)", shown) for key in ("JobState", "ExitCode")}
        return " ".join(match[1] for match in found.values() if match)

    def minutes(self, job: int) -> int:
        """Return the whole minutes since the last start of a job."""
        shown = self._head.run(f"squeue --noheader --jobs={job} --format=%M", shown=False)
        *hours, minutes, _ = map(int, shown.strip().split(":"))
        return sum(hours) * 60 + minutes

    def limit(self, job: int, minutes: int) -> None:
        """Change the time limit of a job, as its administrator."""
        self._head.run(f"scontrol update JobId={job} TimeLimit={minutes}", user="root")

    def restarts(self, job: int) -> int:
        found = re.search(r"\bRestarts=(\d+)", self._head.run(f"scontrol show job {job}", shown=False))
        return int(found[1]) if found else 0

    def log(self, job: int) -> str:
        """Return the output of a job since its first start."""
        path = self.shared / "checkout" / f"tma-ray-{job}.log"
        return path.read_text() if path.exists() else ""

    def ended(self, job: int, seconds: float = 1800) -> str:
        """Wait for the end of a job; return its state."""
        wait_until(lambda: not re.match("PENDING|RUNNING|COMPLETING|REQUEUE", self.state(job)), seconds)
        return self.state(job)
