"""Trials against AdaStop (Mathieu et al., 2023), a group-sequential permutation test, on the same numbers."""

import numpy as np

from analysis.baselines import find_baseline
from analysis.trials.design import in_cell, released_runs
from analysis.trials.rules import DecisionRule, Estimand, Moments, TrialVerdict, difference, planned_fractions

PLACE = ("stump_tracks", "original", "simulated", "simulated", "high")

ADASTOP = {
    "accel": ("smaller", 10),
    "adr": ("larger", 5),
    "alp_gmm": ("equal", 10),
    "covar_gmm": ("larger", 10),
    "currot": ("larger", 5),
    "doraemon": ("larger", 10),
    "goal_gan": ("smaller", 5),
    "goal_gan:preset=release": ("larger", 5),
    "plr": ("equal", 10),
    "ramp": ("larger", 10),
    "riac": ("larger", 5),
    "robust_plr": ("smaller", 10),
    "setter_solver": ("smaller", 10),
    "sfl": ("smaller", 10),
    "sobol": ("equal", 10),
    "spdl": ("smaller", 5),
    "spdl:preset=release": ("smaller", 5),
}
"""Decision and runs of AdaStop 0.1.3 on mastered tasks over training, each teacher of simulated-1 against
Random on the original challenge: MultipleAgentsComparator(n=5, K=2, B=10000, alpha=0.025, seed=0),
runs by seed."""

WORDS = {TrialVerdict.BETTER: "larger", TrialVerdict.WORSE: "smaller", TrialVerdict.OPEN: "equal"}
"""Verdicts as AdaStop names them; its "equal" is what is not decided by the last look."""


def test_both_decide_alike_where_both_decide() -> None:
    runs_there = in_cell(released_runs(find_baseline("simulated-1").frames()), PLACE)
    angles = {name: rows.to_numpy(float)[None] for name, rows in runs_there.groupby("teacher")["angle"]}
    random = angles["random"]
    rule = DecisionRule(
        (5, 10), planned_fractions((5, 10), np.ones(1), np.full(1, 10.0)), margin=1e-9, error=0.025
    )
    estimand = Estimand(np.ones(1), np.ones(1), np.zeros(1))
    found: dict[str, str] = {}
    for teacher in ADASTOP:
        runs = angles[teacher]
        for look, seeds in enumerate(rule.looks):
            test = difference(Moments.of(runs[:, :seeds]), Moments.of(random), estimand)
            found[teacher] = WORDS[TrialVerdict(str(rule.verdicts(test, look)))]
            if found[teacher] != "equal":
                break
    apart = {name for name, (decision, _) in ADASTOP.items() if found[name] != decision}
    assert all("equal" in (found[name], ADASTOP[name][0]) for name in apart)
    assert apart == {"sfl"}  # smaller for AdaStop, not decided here
