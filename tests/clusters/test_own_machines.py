"""`cluster-local.yaml` on machines that one has: the launcher's commands, as docs/clusters.md gives them."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from bed import Bed, Node, bed_of, wait_until
from checkout import CAMPAIGN, SMALL, lend_environment, tables
from launcher import FILE, Laptop
from object_store import BUCKET, ObjectStore
from small_runs import rows

from tma_ray.results import Results, RunStatus, Table

WORKERS = ("one", "two")


@pytest.fixture(scope="module")
def bed() -> Iterator[Bed]:
    with bed_of("laptop", "head", *WORKERS) as bed:
        yield bed


@pytest.fixture(scope="module")
def store(bed: Bed) -> ObjectStore:
    return ObjectStore(bed, "laptop")


@pytest.fixture(scope="module")
def laptop(bed: Bed, wheel: Path, store: ObjectStore) -> Iterator[Laptop]:
    """A laptop that has called `ray up`, and calls `ray down` in the end."""
    for node in bed.on("laptop", "head", *WORKERS):
        lend_environment(node)
        store.make_known(node)
    laptop = Laptop(bed.nodes["laptop"], wheel)
    store.start()
    laptop.up(bed.nodes["head"], [bed.nodes[name] for name in WORKERS])
    yield laptop
    laptop.run(f"ray down --yes {FILE}")
    wait_until(lambda: not any(has_ray(bed.nodes[name]) for name in ("head", *WORKERS)), 120)


@pytest.fixture(scope="module")
def undisturbed(laptop: Laptop, bed: Bed) -> dict[str, str]:
    """Tables of `CAMPAIGN` as a single machine makes them."""
    laptop.run(f"python {CAMPAIGN} --local --results /shared/undisturbed")
    return tables(bed.shared / "undisturbed")


def submitted(results: str, *flags: str) -> str:
    """Return the command that runs `CAMPAIGN` on the cluster."""
    return f"ray submit {FILE} {' '.join(flags)} {CAMPAIGN} --address auto --results {results}"


def trains(node: Node) -> bool:
    """Return True if a run has a process on the node."""
    return "ray::SeedActor" in node.run("ps ax -o args", shown=False)


def has_ray(node: Node) -> bool:
    """Return True if Ray runs on the node."""
    return "raylet" in node.run("ps ax -o args", shown=False)


def checkpoints(root: Path) -> int:
    """Return how many runs have a checkpoint."""
    return len({path.parents[1] for path in root.glob("checkpoints/*/*/index.json")})


def done(root: Path) -> int:
    """Return how many runs are done."""
    return sum('"done"' in path.read_text() for path in root.glob("manifests/*.json"))


def test_a_submitted_script_trains_on_all(laptop: Laptop, bed: Bed, undisturbed: dict[str, str]) -> None:
    assert "4/4 runs done" in laptop.run(submitted("/shared/submitted"))
    root = bed.shared / "submitted"
    assert tables(root) == undisturbed
    assert len({row["host"] for row in rows(root, Table.ATTEMPTS)}) > 1


def test_a_script_in_tmux_goes_on_alone(laptop: Laptop, bed: Bed, undisturbed: dict[str, str]) -> None:
    laptop.run(submitted("/shared/tmux", "--tmux"))
    root = bed.shared / "tmux"
    wait_until(lambda: done(root) == 4, 900)
    assert tables(root) == undisturbed

    flags = "--tier lite --address auto --results /shared/long"
    laptop.run(f"ray submit {FILE} --tmux experiments/full_benchmark.py {flags}")
    screen = "tmux capture-pane -p -S -100 -t $(tmux list-sessions -F '#{session_id}' | tail -1)"
    wait_until(
        lambda: "pass --yes" in bed.nodes["head"].run(screen, code=None, shown=False).replace("\n", " "), 120
    )
    assert not (bed.shared / "long").exists()


def test_a_job_brings_the_module_beside_its_script(laptop: Laptop, bed: Bed) -> None:
    script = f"experiment.py --teachers frontier_teacher:Frontier --seeds 3 --steps 4000 {SMALL}"
    laptop.run(
        f"(ray dashboard {FILE} > /dev/null 2>&1 &); "
        "until (exec 3<>/dev/tcp/127.0.0.1/8265) 2>/dev/null; do sleep 1; done; "
        "ray job submit --address http://127.0.0.1:8265 --working-dir examples -- "
        f"python {script} --address auto --results /shared/job"
    )
    assert [run.status for run in Results.open(bed.shared / "job").runs()] == [RunStatus.DONE] * 3


def test_results_in_an_object_store_are_those_of_a_folder(laptop, undisturbed, store):
    assert "4/4 runs done" in laptop.run(submitted(f"s3://{BUCKET}/results"))
    assert store.tables("results") == undisturbed


def test_runs_of_a_worker_that_is_powered_off_go_on_elsewhere_and_it_is_replaced(laptop, bed, undisturbed):
    root, one = bed.shared / "worker", bed.nodes["one"]
    campaign = laptop.start(f"{submitted('/shared/worker')} --autoscaling")
    wait_until(lambda: trains(one) and checkpoints(root) > 1, 300)
    one.power_off()
    output, _ = campaign.communicate(timeout=900)
    assert "4/4 runs done" in output
    assert "nfeasible" not in output, output
    assert tables(root) == undisturbed
    assert "lost" in {row["outcome"] for row in rows(root, Table.ATTEMPTS)}
    bed.on("one")
    laptop.wait_for_workers(len(WORKERS))


def test_a_powered_off_head_is_made_again(laptop: Laptop, bed: Bed, undisturbed: dict[str, str]) -> None:
    root, head = bed.shared / "head", bed.nodes["head"]
    campaign = laptop.start(submitted("/shared/head"))
    wait_until(lambda: checkpoints(root) > 1, 300)
    head.power_off()
    campaign.communicate(timeout=300)
    assert campaign.returncode != 0
    wait_until(lambda: not any(has_ray(bed.nodes[name]) for name in WORKERS), 120)
    bed.on("head")
    laptop.run(f"ray up --yes {FILE}")
    laptop.wait_for_workers(len(WORKERS))
    wait_until(lambda: "4/4 runs done" in laptop.run(submitted("/shared/head"), code=None), 300)
    assert tables(root) == undisturbed
