"""Specifications of runs, which determine their results, and the random streams derived from them."""

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any, Self

import numpy as np

from tma_ray.benchmark.challenges import BENCHMARK_VERSION
from tma_ray.results import RunRecord, SpecView, input_path, spec_digest
from tma_ray.results.layout import LONGEST_ID
from tma_ray.support.component_names import base_name
from tma_ray.support.decoding import DamagedFileError, decode_json
from tma_ray.support.quantities import COUNT, SEED
from tma_ray.tasks import Dimension, KnowledgeLevel, ShuffledSpace, TaskSpace, TestSet

ABSENT_IF_EMPTY = ("resets", "cuts", "algorithm_versions", "inputs")
"""Fields left out of a spec's JSON if empty, since new fields must not change existing run ids."""


@dataclass(frozen=True)
class Schedule:
    """Budget of a run, and intervals of evaluations, probes and statistics (paper, appendix C), in steps.

    Attributes:
        steps: training budget.
        evaluation_interval: interval between evaluations on the test set; the first evaluation comes before
            the first step, the last one after the last step.
        probe_interval: interval between probes of the curriculum.
        probe_size: number of tasks of a probe.
        training_window: length of the windows of training statistics.
    """

    steps: int = 20_000_000
    evaluation_interval: int = 500_000
    probe_interval: int = 250_000
    probe_size: int = 100
    training_window: int = 500_000

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            COUNT.check(name, value)


@dataclass(frozen=True)
class Plugin:
    """Module and source hash of a run's component that is not part of tma_ray.

    Attributes:
        module: module that defines it.
        digest: hash of its source, which is part of the run id.
    """

    module: str
    digest: str


@dataclass(frozen=True)
class InputFile:
    """Input file of a run, identified by its name and content, not by its folder.

    Attributes:
        name: name without the folder, as shown in results.
        sha256: digest of its bytes, hexadecimal.
    """

    name: str
    sha256: str

    def __post_init__(self) -> None:
        input_path(self.sha256)
        if not self.name or set(self.name) & set("/\\\0") or self.name in (".", ".."):
            raise ValueError(f"input {self.name!r}: expected the name of a file, without a folder")


@dataclass(frozen=True, eq=False)
class RunSpec:
    """Effective specification of a run, with its seed; equal specs give bit-identical results.

    Placement and campaign are not part of it. Knowledge that the teacher does not use is dropped beforehand
    (`expert_knowledge` is the level that it uses), so cells with the same effective spec share a run.

    Attributes:
        environment: name in the environment registry, with the options that differ from its defaults.
        environment_options: keyword arguments of its constructor, the embodiment among them.
        challenge: name of the challenge, with the bounds that differ from its task space; it and the seed
            determine the random parts that all teachers share.
        task_space: space of the teacher's tasks.
        easy_task: task of the environment, mean of the initial distribution at high expert knowledge (d,).
        mastery_threshold: episodic return over which a task is mastered.
        test_set: tasks of evaluations.
        student: name in the student registry, with the hyper-parameters that differ from its defaults.
        student_hyperparameters: all values, including defaults.
        teacher: name in the teacher registry, with the hyper-parameters that differ from its defaults.
        teacher_hyperparameters: all values, including defaults.
        expert_knowledge: effective level.
        schedule: budget and intervals.
        seed: any whole number of at least 0.
        repeat: mixed into the seeds, for independent repeats of cells that would share a run.
        physics_version: version of the physics the run is simulated with.
        plugins: parts among "environment", "student" and "teacher" that do not ship with tma_ray.
        resets: steps after which the student is reset, ascending.
        cuts: intervals per dimension that are permuted in the teacher's space, 0 if it is not shuffled.
        algorithm_versions: declared versions of "environment", "student" and "teacher"; missing in runs from
            before there were versions, and for plug-ins without one.
        inputs: input files by the option that names them, as in "environment.embodiment"; the option holds
            only the file's name.
    """

    environment: str
    environment_options: Mapping[str, Any]
    challenge: str
    task_space: TaskSpace
    easy_task: tuple[float, ...] | None
    mastery_threshold: float
    test_set: TestSet
    student: str
    student_hyperparameters: Mapping[str, Any]
    teacher: str
    teacher_hyperparameters: Mapping[str, Any]
    expert_knowledge: KnowledgeLevel
    schedule: Schedule
    seed: int
    repeat: str = ""
    physics_version: int = 1
    plugins: Mapping[str, Plugin] = field(default_factory=dict)
    resets: tuple[int, ...] = ()
    cuts: int = 0
    algorithm_versions: Mapping[str, int] = field(default_factory=dict)
    inputs: Mapping[str, InputFile] = field(default_factory=dict)

    def __post_init__(self) -> None:
        SEED.check("seed", self.seed)
        if not all(0 < step < later for step, later in pairwise((*self.resets, self.schedule.steps))):
            raise ValueError(
                f"resets after {', '.join(map(str, self.resets))} of {self.schedule.steps} steps: expected "
                f"rising steps between 0 and the budget; raise the budget"
            )

    @property
    def embodiment(self) -> str:
        """Name of the body, or an empty string for environments without bodies."""
        return str(self.environment_options.get("embodiment", ""))

    @cached_property
    def run_id(self) -> str:
        """Id used in file names: a readable prefix and a hash of the whole spec.

        Raises:
            ValueError: if the names of student and teacher make it too long for a file name.
        """
        parts = f"{base_name(self.student)}-{base_name(self.teacher)}"
        readable = re.sub(r"[^0-9a-zA-Z]+", "_", parts).strip("_")
        run_id = f"{readable}-s{self.seed}-{spec_digest(_canonical(self.to_dict()))[:12]}"
        if len(run_id) > LONGEST_ID:
            raise ValueError(
                f"student {self.student!r:.60} and teacher {self.teacher!r:.60} give run ids of "
                f"{len(run_id)} characters, which are part of file names: expected at most {LONGEST_ID}; "
                f"shorten their names"
            )
        return run_id

    @cached_property
    def entropy(self) -> int:
        """Seed of the run's random streams: a hash of everything on which training depends.

        Budget, intervals and test set are excluded, so that a shorter run is a prefix of a longer one.
        So are resets, which depend on the budget: until its first reset, a run equals one without resets.
        """
        content = self.to_dict()
        for name in ("schedule", "test_set", "resets"):
            content.pop(name, None)
        return int(spec_digest(_canonical(content))[:32], 16)

    def record(self) -> RunRecord:
        """Return the run's row in the table of runs."""
        return RunRecord(
            run_id=self.run_id,
            spec=_canonical(self.to_dict()),
            environment=self.environment,
            challenge=self.challenge,
            embodiment=self.embodiment,
            student=self.student,
            teacher=self.teacher,
            expert_knowledge=self.expert_knowledge.value,
            test_set=self.test_set.name,
            steps=self.schedule.steps,
            seed=self.seed,
            physics_version=self.physics_version,
            benchmark_version=BENCHMARK_VERSION,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the spec as JSON values, without empty fields of `ABSENT_IF_EMPTY`."""
        content = {name: value for name, value in vars(self).items() if name in self.__dataclass_fields__}
        content["task_space"] = [asdict(dimension) for dimension in self.task_space.dimensions]
        content["test_set"] = {
            "name": self.test_set.name,
            "dimensions": list(self.test_set.dimensions),
            "tasks": self.test_set.tasks.tolist(),
        }
        content["expert_knowledge"] = self.expert_knowledge.value
        content["schedule"] = asdict(self.schedule)
        content["easy_task"] = None if self.easy_task is None else list(self.easy_task)
        content["plugins"] = {part: asdict(plugin) for part, plugin in self.plugins.items()}
        content["resets"] = list(self.resets)
        content["algorithm_versions"] = dict(self.algorithm_versions)
        content["inputs"] = {option: asdict(file) for option, file in self.inputs.items()}
        for name in ABSENT_IF_EMPTY:
            if not content[name]:
                del content[name]
        return content

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Self:
        """Return the spec from a dictionary returned by `to_dict`.

        Raises:
            ValueError: if the run was imported from another engine.
        """
        if "engine" in content:
            raise ValueError(
                f"this run was imported: {content['engine']} simulated its worlds, and it cannot be run here"
            )
        tests = content["test_set"]
        tasks = np.array(tests["tasks"], dtype=np.float32)
        return cls(
            **{
                **content,
                "task_space": TaskSpace(tuple(Dimension(**d) for d in content["task_space"])),
                "test_set": TestSet(tests["name"], tuple(tests["dimensions"]), tasks),
                "expert_knowledge": KnowledgeLevel(content["expert_knowledge"]),
                "schedule": Schedule(**content["schedule"]),
                "easy_task": None if content["easy_task"] is None else tuple(content["easy_task"]),
                "plugins": {part: Plugin(**plugin) for part, plugin in content["plugins"].items()},
                "resets": tuple(content.get("resets", ())),
                "inputs": {option: InputFile(**file) for option, file in content.get("inputs", {}).items()},
            }
        )

    @classmethod
    def from_json(cls, text: str | bytes, where: str) -> Self:
        """Return the spec from the JSON of a dictionary returned by `to_dict`.

        Args:
            text: JSON.
            where: name of the file, for messages.

        Raises:
            DamagedFileError: if it is not a spec; the message names the file and, where known, the field.
            ValueError: if the run was imported from another engine.
        """
        facts = decode_json(text, SpecView, where)
        content = decode_json(text, dict[str, Any], where)
        if facts.engine is not None:
            return cls.from_dict(content)  # raises a ValueError, since the run was imported
        try:
            return cls.from_dict(content)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise DamagedFileError(f"{where} is not the spec of a run: {error!r:.200}") from error


def _canonical(content: Mapping[str, Any]) -> str:
    """Return the canonical JSON of a spec for hashing and storage, refusing infinities and NaN."""
    try:
        return json.dumps(content, sort_keys=True, allow_nan=False)
    except ValueError as error:
        raise ValueError(
            f"every number of a run must be finite: {error}; check its hyper-parameters"
        ) from error


@dataclass(frozen=True)
class Streams:
    """Independent seeds for the parts of a run, spawned in the order of the fields."""

    teacher: np.random.SeedSequence
    environment: np.random.SeedSequence
    student: np.random.SeedSequence
    trials: np.random.SeedSequence

    @classmethod
    def of(cls, spec: RunSpec) -> "Streams":
        """Return the random streams of a run, derived from the hash of its effective spec and its seed."""
        return cls(*np.random.SeedSequence([spec.entropy, spec.seed]).spawn(4))


def placement_generator(spec: RunSpec) -> np.random.Generator:
    """Return the generator for the random parts of the challenge, which are the same for all teachers."""
    words = [_hash(f"{spec.environment}/{spec.challenge}/{spec.repeat}"), spec.seed]
    return np.random.default_rng(np.random.SeedSequence(words))


def task_space_shuffle(spec: RunSpec, placement: np.random.Generator) -> ShuffledSpace | None:
    """Return the map from the teacher's tasks to the world's, or None if the space is not shuffled.

    The shuffle is the first draw of the `placement_generator`.
    """
    return ShuffledSpace.shuffle(spec.task_space, placement, spec.cuts) if spec.cuts else None


def evaluation_seeds(test_set: TestSet) -> list[int]:
    """Return an environment seed for each test task, the same in all evaluations of all runs."""
    sequences = (np.random.SeedSequence([_hash(test_set.digest), index]) for index in range(len(test_set)))
    return [int(sequence.generate_state(1)[0] >> 1) for sequence in sequences]


def _hash(text: str) -> int:
    return int(hashlib.sha256(text.encode()).hexdigest()[:16], 16)
