"""Command `trial`: test of a new teacher against a release, with a design fixed beforehand."""

from __future__ import annotations

import hashlib
import re
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from tma_ray.campaign.options import EXECUTION_DEFAULTS, TrialOptions
from tma_ray.cli.common_options import Name
from tma_ray.console.command_line import command
from tma_ray.console.exit_codes import RefusedError
from tma_ray.console.terminal import print_line
from tma_ray.results import Results, Store, TrialFile, TrialLook, check_usable, create_root
from tma_ray.support.component_names import base_name

if TYPE_CHECKING:
    import pandas as pd

    from analysis.data.frames import Frames
    from analysis.trials.design import Design
    from analysis.trials.interim import InterimLook
    from tma_ray.campaign.plan import Plan

REHEARSED = "simulated-1"
"""Release of rehearsals on simulated students."""

ALL_CELLS = ("all",)
"""Value of ``--cells`` for all cells of the release."""

PAGE = "trial"  # folder of the page in the results root


@command(defaults=EXECUTION_DEFAULTS)
def trial(name: Name, /, *, options: TrialOptions = TrialOptions()) -> int:
    """Try a new teacher against a release: whether it is better, worse or alike.

    It is compared with Random and the best teacher of the release, by a design that is fixed before the
    first run: looks after 3, 5, 10 and 20 seeds of every cell, stopped early for success, likeness and
    futility. The same command continues.

    Args:
        name: teacher, as module:Name, file.py:Name or a registered name

    Examples:
        tma-ray trial riac --simulated
        tma-ray trial riac --budget 8h --dry-run
    """
    from analysis.baselines import find_baseline, newest_release
    from analysis.measures.tested import AREA_MARGIN
    from analysis.trials.design import Design, make_design, released_runs
    from analysis.trials.interim import plan_lines
    from tma_ray.campaign.repeating import trial_plans
    from tma_ray.campaign.trials import campaign_of, simulated_cells
    from tma_ray.teachers import TEACHERS, canonical_teacher

    store = Store.open(options.results)
    check_usable(store)
    teacher = canonical_teacher(name)
    saved = TrialFile.load(store)
    before = Design.of(saved.design, str(store)) if saved else None
    against = options.against or (before.release if before else REHEARSED if options.simulated else "")
    baseline = find_baseline(against) if against else newest_release()
    frames = baseline.frames()
    default = tuple(cell.name for cell in before.cells) if before else baseline.manifest.trial_cells
    cells = options.cells or default
    margin = options.margin or (before.margin if before else AREA_MARGIN)
    steps = options.steps or (before.steps if before else None)
    if cells == ALL_CELLS:
        cells = ()
    released = released_runs(frames, steps)
    if before and before.is_asked_for(teacher, baseline.manifest.name, cells, margin, steps):
        design = before.renewed(released)
    else:
        design = make_design(teacher, baseline, frames, margin, cells, steps=steps)
    places, plans = design.keys, []
    if options.simulated:
        simulated_cells(teacher, places)  # raises an error if the teacher cannot teach some cells
        plugin = TEACHERS.plugin(teacher)
        design = replace(design, runs=plugin.digest if plugin else "")
    else:
        results = Results(baseline.store())
        looks = [design.seeds[:count] for count in design.looks]
        plans = trial_plans(campaign_of(teacher), results, teacher, places, looks, steps)
        names = "\n".join(spec.run_id for spec in plans[-1].runs)
        design = replace(design, runs=hashlib.sha256(names.encode()).hexdigest())
    if before and before.differing(design):
        raise RefusedError(
            f"{store} holds another trial, whose design is fixed ({'; '.join(before.differing(design))}): "
            f"choose another --results for this one"
        )
    design = before or design
    for line in plan_lines(design, released):
        print_line(line)
    if {cell.name for cell in design.cells} == set(baseline.manifest.trial_cells):
        print_line(f"  these are the default cells of trials against {design.release}; --cells all takes all")
    return _started(options, _Trial(store, design, released, frames), plans)


def _started(options: TrialOptions, trial: _Trial, plans: list[Plan]) -> int:
    from tma_ray.campaign import trials
    from tma_ray.campaign.script import confirm, copy_released
    from tma_ray.testing.conformance import check_quickly

    if copied := copy_released(trial.store, options):
        print_line(copied)
    runs = trials.TrialRuns(plans, options) if plans else None
    cost = runs.cost() if runs else None
    if cost:
        print_line("at most, " + cost.describe())
    if options.dry_run:
        return 0
    if runs and cost is not None and min(cost.wall_hours, options.budget or cost.wall_hours) > 1:
        confirm(plans[-1].name, cost, yes=options.yes, address=runs.address)
    trial.affordable = trials.affordable_look(runs, cost) if runs else None
    check_quickly(trial.design.teacher)
    if TrialFile.load(trial.store) is None:
        create_root(trial.store)
        TrialFile(trial.design.to_dict()).save(trial.store)
    if runs:
        code = trials.run_looks(runs, cost, trial.judge)
    else:
        seeds = [trial.design.seeds[:count] for count in trial.design.looks]
        cells = trials.simulated_cells(trial.design.teacher, trial.design.keys)
        code = trials.simulate_looks(cells, seeds, options, trial.judge)
    trial.conclude()
    return code


@dataclass
class _Trial:
    """Running trial, with its design, the released runs and the interim looks so far.

    Attributes:
        store: results root.
        design: fixed design of the trial.
        released: runs to compare with.
        frames: frames of the release.
        looks: interim looks so far.
        affordable: index of the last interim look within the budget; None for all.
    """

    store: Store
    design: Design
    released: pd.DataFrame
    frames: Frames
    looks: list[InterimLook] = field(default_factory=list)
    affordable: int | None = None

    def judge(self) -> bool:
        """Print new verdicts, save the trial and its page, and return True if the trial ends."""
        from analysis.data.loading import frames_of
        from analysis.pages.page import page_folder
        from analysis.pages.trial import write_trial
        from analysis.trials.design import ended_runs
        from analysis.trials.interim import completed_looks, look_line

        printed = len(self.looks)
        frames = frames_of(Results(self.store))
        self.looks = completed_looks(self.design, self.released, ended_runs(frames), self.affordable)
        lines = tuple(TrialLook(look.seeds, look_line(look)) for look in self.looks)
        for line in lines[printed:]:
            print_line(line.said)
        ending = self.looks[-1].ending if self.looks else ""
        TrialFile(self.design.to_dict(), lines, str(ending)).save(self.store)
        with tempfile.TemporaryDirectory() as temporary:
            local = Path(temporary) if self.store.is_object_store else None
            folder = page_folder(str(self.store), local, PAGE, "page")
            write_trial(folder, self.design, self.released, self.looks, self.frames, frames)
            for file in local.iterdir() if local else ():
                self.store.write_bytes(f"{PAGE}/{file.name}", file.read_bytes())
        return bool(ending)

    def conclude(self) -> None:
        """Print the verdict and the next command if the trial has ended."""
        from analysis.trials.interim import sentence

        if not (self.looks and self.looks[-1].ending):
            return
        name = re.sub(r"[^0-9a-z]+", "-", base_name(self.design.teacher).lower()).strip("-")
        hint = f"Next: 'tma-ray release {self.store} {name}-1 --lean --licence CC-BY-4.0'"
        page = f"page: {self.store.where(f'{PAGE}/index.html')}"
        for line in (sentence(self.design, self.looks[-1]), page, hint):
            print_line(line)
