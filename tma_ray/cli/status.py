"""Commands `status`, `logs`, `list`, `verify`, `compact`, `doctor` and `completion`."""

import os
import platform
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal, get_args

from tma_ray import __version__
from tma_ray.cli.common_options import Folder, Json, Root, RunResults
from tma_ray.cli.json_output import print_json, status_record
from tma_ray.console.command_line import choice, command, value
from tma_ray.console.exit_codes import FAILED, installed_version
from tma_ray.console.types import named
from tma_ray.support.texts import counted

DAMAGED = 1  # exit code of a damaged or incomplete root

CPU_FEATURES = {"avx2": "AVX2", "avx512f": "AVX-512", "avx512_bf16": "AVX-512 BF16", "amx_bf16": "AMX BF16"}
"""Vector extensions for matrix products, by their names in /proc/cpuinfo."""

Shell = Literal["bash", "zsh", "fish"]

LISTINGS = ("teachers", "students", "environments", "embodiments", "challenges", "test-sets", "experiments")


@command()
def status(root: Root, /, *, cells: bool = False, watch: bool = False, json: Json = False) -> int:
    """Print the progress of the campaigns of a results root.

    It shows their speed and why runs failed, and may be called from any machine that sees the root. The exit
    code is 1 if runs have failed.

    Args:
        root: results root
        cells: print a line for every cell
        watch: print it again every few seconds, until Ctrl-C
    """
    from tma_ray.campaign.progress import overview, show_status, watch_status

    if json:
        now = time.time()
        state = overview(root, now)
        print_json("status", status_record(root, state, now))
        return FAILED if state.failed else 0
    if watch:
        watch_status(root, cells)
    return FAILED if show_status(root, cells) else 0


@command()
def logs(
    run: Annotated[str, value(named("the ID of a run"), "RUN")], /, *, results: RunResults = "results"
) -> int:
    """Print the history of a run, with the error that ended it.

    These are the attempts at the run, their outcomes, and the traceback of the error.

    Args:
        run: ID of a run, or an unambiguous beginning of it
    """
    from tma_ray.campaign.progress import show_history

    show_history(run, results)
    return 0


@command()
def verify(root: Root, /, *, complete: bool = False, json: Json = False) -> int:
    """Compare a results root or a release with what was written.

    Every file is compared with the manifests: checksums, row counts, specs with the IDs of their runs. This
    finds accidents of disks, copies and editors, not malice. The exit code is 1 if something is damaged; the
    campaign's own command repeats such runs.

    Args:
        root: results root, or folder or name of a release
        complete: check also that a release is complete: every planned run, equal seeds, a licence, no names
            of machines

    Examples:
        tma-ray verify results
        tma-ray verify results --json
    """
    from analysis.baselines import as_baseline
    from analysis.baselines import verify as verify_release
    from analysis.baselines.verification import lacking
    from tma_ray.results import Store, verify_root

    baseline = as_baseline(root)
    if complete and baseline is None:
        raise ValueError(f"{root} is not a release, which --complete is about; see 'tma-ray release'")
    if baseline is not None:
        released = verify_release(root)
        runs, files = baseline.manifest.holds.get("runs", 0), len(baseline.manifest.files)
        damage, unlisted = released.damage, tuple[str, ...]()
    else:
        check = verify_root(Store.open(root))
        runs, files, damage, unlisted = check.runs, len(check.files), check.damage, check.unlisted
    lacks = lacking(baseline) if baseline and complete and not damage else []
    if json:
        record = {"root": root, "whole": not damage, "runs": runs, "files": files}
        rest = {"damage": [asdict(item) for item in damage], "unlisted": unlisted, "lacking": lacks}
        print_json("verify", record | rest)
    else:
        ignored = (f"{path}: it belongs to no run and is ignored" for path in unlisted)
        state = f"damaged: {len(damage):,} problems" if damage else "whole"
        whole = f"{root} is {state}; {counted(runs, 'run')}, {counted(files, 'file')}"
        print(*map(str, damage), *ignored, *lacks, whole, sep="\n")
        if complete and not damage:
            print(f"it is incomplete: {len(lacks)} things are missing" if lacks else "it is complete")
    return DAMAGED if damage or lacks else 0


@command()
def compact(root: Root, /) -> int:
    """Merge the files of finished runs, by experiment.

    The result is one file per table and experiment.

    Args:
        root: results root
    """
    from tma_ray.results import compact as merge

    done = merge(root)
    print(
        f"{done.runs:,} runs merged: {done.files_before:,} files of tables became {done.files_after:,}, "
        f"{done.bytes_before:,} bytes {done.bytes_after:,}"
    )
    return 0


@command()
def doctor(*, results: Folder = Path("results"), json: Json = False) -> int:
    """Describe what this machine offers a campaign.

    These are versions, physics engine, CPU, memory, GPU, Ray and free disk.

    Args:
        results: folder of results, whose disk is examined
    """
    import torch
    from rich.table import Table

    from tma_ray.benchmark import BENCHMARK_VERSION
    from tma_ray.console.terminal import terminal
    from tma_ray.physics import PHYSICS_VERSION, engine_in_use
    from tma_ray.results import SCHEMA_VERSION
    from tma_ray.runs.placement import LIBRARIES, cpu_model, usable_cores

    description, features = Path("/proc/cpuinfo"), "features unknown"
    if description.exists():
        flags = set(description.read_text().split())
        extensions = [name for flag, name in CPU_FEATURES.items() if flag in flags]
        features = ", ".join(extensions) or "without vector extensions that matter here"
    libraries = [f"{library} {installed_version(library)}" for library in (*LIBRARIES, "ray", "pyarrow")]
    engine = engine_in_use()
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30
    gpus = range(torch.cuda.device_count() if torch.cuda.is_available() else 0)
    address = os.environ.get("RAY_ADDRESS")
    folder = next(path for path in (results.absolute(), *results.absolute().parents) if path.exists())
    topics = {
        "tma_ray": f"{__version__}, Python {platform.python_version()}, {platform.platform(terse=True)}",
        "benchmark": f"version {BENCHMARK_VERSION}, physics {PHYSICS_VERSION}, schema {SCHEMA_VERSION}",
        "libraries": ", ".join(libraries),
        "physics engine": f"{engine.name}: {engine.reason}",
        "CPU": f"{cpu_model()}, {counted(usable_cores(), 'usable core')}, {features}",
        "memory": f"{memory:.1f} GiB",
        "GPU": ", ".join(map(torch.cuda.get_device_name, gpus)) or "none that torch can use",
        "Ray": f"would join {address} (RAY_ADDRESS)"
        if address
        else "would start on this machine; no RAY_ADDRESS",
        "free disk": f"{shutil.disk_usage(folder).free / 2**30:.1f} GiB at {folder}",
    }
    if json:
        print_json("doctor", {"topics": topics})
        return 0
    table = Table(box=None, show_header=False, pad_edge=False)
    for topic, finding in topics.items():
        table.add_row(topic, finding)
    terminal().print(table)
    return 0


@command(name="list")
def list_(kind: Annotated[str, choice(LISTINGS)] = "", /, *, json: Json = False) -> int:
    """List teachers, students, environments and all else that has a name.

    Each has a description; bodies, challenges, test sets and experiments are among them.

    Args:
        kind: one kind only
    """
    from tma_ray.benchmark import CHALLENGES, EXPERIMENTS, load_test_set, shipped_test_sets
    from tma_ray.embodiments import embodiment_names, load_embodiment
    from tma_ray.envs import ENVIRONMENTS
    from tma_ray.students import STUDENTS
    from tma_ray.teachers import TEACHERS

    def body(name: str) -> str:
        embodiment = load_embodiment(name)
        parts, motors = len(embodiment.parts), len(embodiment.motors)
        return f"{embodiment.body_type.capitalize()} of {parts} parts with {motors} motors."

    def test_set(name: str) -> str:
        tests = load_test_set(name)
        return f"{len(tests)} tasks of {len(tests.dimensions)} dimensions."

    listings: dict[str, Callable[[], Mapping[str, str]]] = {
        "teachers": TEACHERS.summaries,
        "students": STUDENTS.summaries,
        "environments": ENVIRONMENTS.summaries,
        "embodiments": lambda: {name: body(name) for name in embodiment_names()},
        "challenges": lambda: {f"{c.name} ({c.environment})": f"{c.title}." for c in CHALLENGES},
        "test-sets": lambda: {name: test_set(name) for name in shipped_test_sets()},
        "experiments": lambda: {experiment.name: f"{experiment.title}." for experiment in EXPERIMENTS},
    }
    descriptions = {name: listings[name]() for name in ([kind] if kind else LISTINGS)}
    if json:
        kinds = {
            listing: [{"name": name, "description": text} for name, text in described.items()]
            for listing, described in descriptions.items()
        }
        print_json("list", {"kinds": kinds})
        return 0
    from rich.table import Table

    from tma_ray.console.terminal import terminal

    console = terminal()
    for listing, described in descriptions.items():
        table = Table(box=None, show_header=False, padding=(0, 2, 0, 2), pad_edge=True)
        table.add_column(no_wrap=True)
        table.add_column()
        for name, text in described.items():
            table.add_row(name, text)
        console.print(f"{listing}:", highlight=False)
        console.print(table, highlight=False, markup=False)
    return 0


@command()
def completion(shell: Annotated[Shell, choice(get_args(Shell))], /) -> int:
    """Print a completion script for a shell.

    It completes commands, options and paths, and belongs into the shell's start-up file.

    Args:
        shell: shell to complete in

    Examples:
        eval "$(tma-ray completion bash)"   # in ~/.bashrc
        tma-ray completion zsh > ~/.zfunc/_tma-ray
    """
    from tma_ray.cli import app

    print(app().generate_completion(shell=shell))
    return 0
