"""Changes to the code of pages before it is run, and code that is not run, with reasons."""

from fnmatch import fnmatch
from typing import NamedTuple


class Change(NamedTuple):
    """Text in the code of pages, and its replacement before it is run."""

    pages: str
    found: str
    instead: str
    reason: str


class Exemption(NamedTuple):
    """Command or block that is not run, given its beginning."""

    pages: str
    beginning: str
    reason: str


class Ending(NamedTuple):
    """Command with an exit code other than 0, given its beginning."""

    pages: str
    beginning: str
    code: int
    reason: str


BUCKET = "a folder stands for the bucket; tests/object_stores runs campaigns in a real one"
ENDLESS = "it would go on until Ctrl-C"

CHANGES = (
    Change("docs/baselines.md", '", "s3://bucket/', '", "memory://', "fsspec's, in this process"),
    Change("*", "s3://bucket/", "", BUCKET),
    Change("*", "s3://my-bucket/stumps", "results", BUCKET),
    Change("*", " --watch", "", ENDLESS),
    Change("*", "/shared/results", "results", "there is no such folder here"),
    Change("*", "sac_alp_gmm-s0-…", "{run}", "the name of a run that there is"),
    Change("*", 'load_policy("sac"', 'load_policy("ppo"', "whose student is PPO"),
    Change("*", "sac_alp_gmm-s0", "{run}", "likewise"),
    Change("docs/baselines.md", "colleague", "results", "whose runs are there"),
    Change("docs/baselines.md", "compare mine", "compare results", "the campaign is only planned"),
    Change("docs/add_teacher.md", "compare mine", "compare results", "likewise"),
    Change("docs/add_teacher.md", "--seeds 10", "--seeds 2", "as many as are needed for a test"),
    Change("docs/releasing.md", "--stage core", "--stage core --challenges original", "fewer speeds"),
    Change("docs/releasing.md", "--stage levels", "--stage core --challenges original", "likewise"),
    Change("docs/releasing.md", "--lean", "--lean --partial", "its campaign is only begun"),
    Change("docs/policies.md", "releases/lite-2-policies --policy ppo_riac-s2-3ad4", "results --policy {run}",
           "the pages are run outside of the repository"),
    Change("docs/policies.md", '", "walker"', '", "again"', "walker is there by then"),
    Change("notebooks/README.md", "' jupyterlab", "'", "the tests do without JupyterLab"),
    Change("examples/README.md", "report ../staircase", "report ../results", "its campaign is only planned"),
    Change("docs/simulated_students.md", "--seeds 10 ", "--teachers random,riac ", "all take minutes"),
    Change("*", "trial riac --simulated", "trial riac --simulated --dry-run",
           "tests/campaign/test_trial.py rehearses one"),
    Change("docs/trials.md", "frontier_teacher.py:Frontier --simulated", "riac --simulated --dry-run",
           "likewise"),
    Change("docs/trials.md", "frontier_teacher.py:Frontier", "riac", "a teacher that there is"),
    Change("*", "pytest test_frontier_teacher.py", "pytest -k hyperparameters test_frontier_teacher.py",
           "tests/test_examples.py has all of the kit pass"),
)  # fmt: skip

INSTALLED = "the tests run in such an environment"
ACCOUNT = "needs an account of AWS"
KUBERNETES = "needs a Kubernetes"
COMPILER = "tests/playground/test_building.py builds where the compiler is installed"

EXEMPTIONS = (
    Exemption("*", "source .venv/bin/activate", INSTALLED),
    Exemption("*", ". .venv/bin/activate", INSTALLED),
    Exemption("docs/clusters.md", "umask 077", "of the shell alone"),
    Exemption("docs/clusters.md", "chmod 600", "the file is in the user's home"),
    Exemption("docs/clusters.md", "aws ec2 ", ACCOUNT),
    Exemption("docs/kubernetes.md", "docker ", "needs a container engine"),
    Exemption("docs/kubernetes.md", "kubectl ", KUBERNETES),
    Exemption("docs/which_cluster.md", "docker ", "needs a container engine"),
    Exemption("docs/which_cluster.md", "kubectl ", KUBERNETES),
    Exemption("docs/which_cluster.md", "scancel ", "tests/clusters/test_slurm.py runs it"),
    Exemption("docs/analysis.md", "", "tests/analysis/test_python_api.py runs it on the notebooks' runs"),
    Exemption("notebooks/README.md", "TMA_RESULTS=", "tests/test_notebooks.py runs the notebooks"),
    Exemption("docs/playground.md", "pip install ziglang", COMPILER),
    Exemption("docs/playground.md", "python docs/making/make_playground.py", COMPILER),
    Exemption("docs/policies.md", "cc ", "needs a C compiler"),
    Exemption("docs/policies.md", "LD_PRELOAD=", "of the library that was not compiled"),
    Exemption("docs/releasing.md", "git worktree", "there is no repository where the tests run"),
    Exemption(
        "docs/training_code.md",
        "import gymnasium\nimport numpy as np\nfrom tianshou",
        "tests/test_training_code.py runs it where Tianshou is installed",
    ),
    Exemption("docs/optuna.md", "import optuna", "tests/test_library.py runs it where Optuna is installed"),
    Exemption("docs/object_stores.md", "polars.scan_parquet", "neither polars nor DuckDB is installed"),
    Exemption("docs/results.md", "duckdb.sql", "DuckDB is not installed"),
    Exemption("docs/results.md", "runs, evaluations =", "polars is not installed"),
)
"""Code that is not run; all other code must run."""

ENDINGS = (
    Ending("*", "tma-ray stop", 2, "no campaign is at work on that root"),
    Ending("*", "tma-ray rerun", 2, "no run of that root has failed"),
    Ending("*", "tma-ray search", 0, "says that nothing was searched"),
)


def changed(page: str, text: str, **values: str) -> str:
    """Return the code of a page with its `CHANGES`; `values` fill in placeholders."""
    for change in CHANGES:
        if fnmatch(page, change.pages):
            text = text.replace(change.found, change.instead.format(**values))
    return text


def exempt(page: str, text: str) -> bool:
    """Return True if a command or block is not run."""
    return any(fnmatch(page, each.pages) and text.startswith(each.beginning) for each in EXEMPTIONS)


def exit_code(page: str, command: str) -> int:
    """Return the expected exit code of a command."""
    codes = (it.code for it in ENDINGS if fnmatch(page, it.pages) and command.startswith(it.beginning))
    return next(codes, 0)
