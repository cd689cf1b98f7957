"""Checks of code blocks with data, by language."""

import sys
import tomllib
from pathlib import Path

import yaml
from commands import understood

from tma_ray.components.registry import Registry
from tma_ray.embodiments import load_embodiment
from tma_ray.envs import ENVIRONMENTS
from tma_ray.students import STUDENTS
from tma_ray.tasks import TestSet
from tma_ray.teachers import TEACHERS

REGISTRIES: dict[str, Registry] = {one.entry_point_group: one for one in (TEACHERS, STUDENTS, ENVIRONMENTS)}


def check_toml(text: str, folder: Path) -> None:
    """Check a body, or entry points of plug-ins."""
    content = tomllib.loads(text)
    if "parts" in content:
        path = folder / "shown.toml"
        path.write_text(text)
        assert load_embodiment(path).name == content["name"]
        return
    ((group, points),) = content["project"]["entry-points"].items()
    installed = folder / "installed" / f"{group.replace('.', '_')}-1.0.dist-info"
    installed.mkdir(parents=True)
    sys.path.append(str(installed.parent))
    lines = [f"{name} = {target}" for name, target in points.items()]
    (installed / "entry_points.txt").write_text("\n".join([f"[{group}]", *lines]))
    (installed / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {group}\nVersion: 1.0\n")
    for name, target in points.items():
        assert name in REGISTRIES[group].names()
        assert REGISTRIES[group].get(name) is REGISTRIES[group].get(target)


def check_csv(text: str, folder: Path) -> None:
    """Check a test set."""
    path = folder / "shown.csv"
    path.write_text(text)
    assert len(TestSet.from_csv(path).tasks) == len(text.splitlines()) - 1


def check_yaml(text: str, folder: Path) -> None:
    """Check the configuration of a cluster, such as cluster.yaml."""
    from ray.autoscaler._private.util import prepare_config, validate_config

    validate_config(prepare_config(yaml.safe_load(text)))


def check_console(text: str, folder: Path) -> None:
    """Check the commands of a transcript."""
    typed = [line[2:].split() for line in text.splitlines() if line.startswith("$ ")]
    assert typed
    for words in typed:
        if words[0] == "tma-ray" and words[1:] != ["--help"]:
            understood(words)


CHECKS = {"toml": check_toml, "csv": check_csv, "yaml": check_yaml, "console": check_console}
