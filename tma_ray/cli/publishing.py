"""Commands `release` and `baselines`."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

from tma_ray.campaign.options import names
from tma_ray.cli.common_options import Baseline, Json, Licence, Name, Root
from tma_ray.cli.json_output import baselines_record, print_json
from tma_ray.console.command_line import command, value
from tma_ray.console.types import named
from tma_ray.console.types import root as read_root

NOT_WHOLE = 1


@command(name="list")
def baselines_list(*, json: Json = False) -> int:
    """List the baselines that have a name.

    Each has its engine, runs, teachers, licence and place.
    """
    if json:
        print_json("baselines list", baselines_record())
        return 0
    from analysis.commands.releases import show_baselines

    show_baselines()
    return 0


@command(name="path")
def baselines_path(baseline: Baseline, /) -> int:
    """Print the folder of a baseline.

    Args:
        baseline: name of the baseline
    """
    from analysis.baselines import find_baseline

    print(find_baseline(baseline).location)
    return 0


@command(name="verify")
def baselines_verify(baseline: Baseline, /) -> int:
    """Check that a baseline is what was released.

    The checksums of its files are compared with those that were released.

    Args:
        baseline: name, folder or address of the baseline
    """
    from analysis.commands.releases import show_verification

    return 0 if show_verification(baseline) else NOT_WHOLE


@command()
def release(
    root: Root,
    name: Name,
    /,
    *,
    output: Annotated[str, value(read_root, "FOLDER", alias="-o")] = "",
    licence: Licence = "",
    partial: bool = False,
    lean: bool = False,
    policies: bool = False,
    shard: Name | None = None,
    core: Annotated[tuple[str, ...], value(names, "NAME,...")] = (),
    gaps: Annotated[str, value(named("a sentence"), "TEXT")] = "",
    budget_note: Annotated[str, value(named("a sentence"), "TEXT")] = "",
    trial_cells: Annotated[tuple[str, ...], value(names, "NAME,...")] = (),
) -> int:
    """Pack a finished campaign as a baseline for others.

    With --shard, add the finished runs of the results root to a release that grows, or begin one.

    Args:
        root: results root of the campaign
        name: name of the baseline
        output: folder or address in which the baseline's own folder, NAME, is made (default: the current one)
        licence: licence of the results, as CC-BY-4.0 (default: none)
        partial: allow missing runs, and mark the baseline so
        lean: leave out episodes, logs of teachers, policies and names of machines, and round: 10 kB a run
        policies: pack, lean, the run with the median result of each cell, and its final policy as float16
        shard: name of files that add the finished runs that the release lacks, lean (default: pack all)
        core: campaigns that 'tma-ray campaign --like' repeats (default: all)
        gaps: campaigns that the release is to have and that have not begun, for its card (default: none)
        budget_note: sentence about its rankings at longer budgets, for its leaderboards (default: none)
        trial_cells: default cells of trials against it, as by 'tma-ray trial --cells' (default: all)

    Examples:
        tma-ray release results mine-1.0 --licence CC-BY-4.0
        tma-ray release results mine-1.0 --output s3://bucket/releases
        tma-ray release results growing --shard batch-1 --licence CC-BY-4.0
        tma-ray release results mine-1.0-policies --policies --licence CC-BY-4.0
    """
    from analysis.baselines import About, add_to_release, check_address, median_policies, publish
    from analysis.baselines import release as write
    from tma_ray.results import LEAN, WHOLE

    if policies and (shard or lean):
        raise ValueError("--policies makes a lean release of its own: leave --lean and --shard out")
    about = About(core, gaps, budget_note, trial_cells)

    def packed(folder: Path) -> Path:
        if shard:
            return add_to_release(root, name, shard, folder, licence, about=about)
        contents = median_policies(root, core) if policies else LEAN if lean else WHOLE
        return write(root, name, folder, licence, partial=partial, contents=contents, about=about)

    if "://" not in output:
        print(packed(Path(output)))
        return 0
    if shard:
        raise ValueError("--shard adds to a release in a folder: publish it from there when it is whole")
    address = f"{output.rstrip('/')}/{name}"
    check_address(address)
    with TemporaryDirectory(prefix="tma_ray_release_") as aside:
        print(publish(packed(Path(aside)), address))
    return 0
