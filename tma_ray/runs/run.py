"""Training of a student by a teacher, one episode at a time, without Ray."""

import pickle
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from tma_ray.envs import ENVIRONMENTS
from tma_ray.results import RunWriter, Table
from tma_ray.runs.evaluation import Evaluation, UntrainedEpisodes
from tma_ray.runs.inputs import arguments, import_plugins, new_environment
from tma_ray.runs.placement import Placement
from tma_ray.runs.spec import RunSpec, Streams, placement_generator, task_space_shuffle
from tma_ray.runs.teaching import Reply, TeacherLink
from tma_ray.students import Student, Transition, make_rollout_worker, make_student
from tma_ray.support.component_names import base_name
from tma_ray.tasks import (
    Answer,
    Episode,
    EpisodeSoFar,
    Query,
    QueryKind,
    Recorder,
    Task,
    TeacherUpdate,
    check_return,
)


@dataclass
class Progress:
    """Progress of a run, saved in every checkpoint.

    Attributes:
        step: environment steps played.
        episodes: training episodes finished.
        evaluations: evaluations done.
        window: (episodic return, length, success) of episodes with learning in the current training window.
        next_task: task of the next episode.
        record_next: True if the teacher needs that episode's trajectory.
        next_trains: True if the student learns from that episode.
    """

    step: int = 0
    episodes: int = 0
    evaluations: int = 0
    window: list[tuple[float, int, bool]] = field(default_factory=list)
    next_task: Task | None = None
    record_next: bool = False
    next_trains: bool = True


STUDENT = "student"  # folder of the student in a saved run


class Run:
    """Training of a student by a teacher, from the first step until the budget is spent.

    `advance` plays one episode. The run can be saved between two calls, and a new run of the same spec that
    loads the state continues bit for bit.

    A reset of the student takes place between two steps, even within an episode, and after everything else
    due at that step: the teacher observes an episode that ends there, and evaluation and probe precede the
    reset. The steps of an evaluation that the teacher requests count at once; events due during it follow
    once the teacher has chosen its next task.

    Raises:
        ValueError: if environment or student is a plug-in whose source differs from the planned one.
    """

    def __init__(
        self, spec: RunSpec, teacher: TeacherLink, writer: RunWriter, placement: Placement | None = None
    ) -> None:
        self.spec = spec
        self.teacher = teacher
        self.writer = writer
        self.progress = Progress()
        import_plugins(spec, "environment", "student")
        self.environment = new_environment(spec)
        # environments of plug-ins may reuse one array for all observations
        self._copies = ENVIRONMENTS.origin(spec.environment) is not None
        streams = Streams.of(spec)
        self._episode_seeds = np.random.default_rng(streams.environment)
        placement = placement or Placement()
        spaces = self.environment.observation_space, self.environment.action_space
        parts = base_name(spec.student), *spaces, streams.student, arguments(spec, "student")
        self.student: Student = (
            make_student(*parts, placement.device, placement.threads)
            if placement.learner is None
            else make_rollout_worker(*parts, placement.learner)
        )
        self._landscape = task_space_shuffle(spec, placement_generator(spec))
        self._evaluation = Evaluation(spec)
        self._untrained = UntrainedEpisodes(spec, streams.trials)
        self._next_event = 0

    @property
    def finished(self) -> bool:
        """True if the budget is spent and the last evaluation is done."""
        return self.progress.step >= self.spec.schedule.steps

    def advance(self) -> Episode | None:
        """Play one episode, with the evaluations, probes and resets due during it.

        Returns:
            The episode, or None if the budget ended it.

        Raises:
            ValueError: if the student has diverged, a return is not finite, or a component refuses a value.
        """
        try:
            if self.progress.next_task is None:
                self._events(0)
                self._receive(self.teacher.exchange(None))
            episode = self._play()
        except ValueError as error:
            if self._diverged():
                raise ValueError(
                    f"student {self.spec.student!r} has diverged by step {self.progress.step}: its "
                    f"actions or values are not finite ({error}); try a smaller learning rate, and check "
                    f"observations and rewards"
                ) from error
            raise
        if self.finished:
            self._record_window(self.progress.step)
        return episode

    def save(self, folder: Path, incremental: bool = False) -> tuple[str, ...]:
        """Write the complete state between two episodes to an existing, empty folder.

        Args:
            folder: target folder.
            incremental: True to leave out files unchanged since the last saved or loaded state.

        Returns:
            The paths in `folder` of files left out, which `load` needs there.
        """
        (folder / STUDENT).mkdir()
        unchanged = self.student.save(folder / STUDENT, incremental)
        state = {
            "progress": asdict(self.progress),
            "episode_seeds": self._episode_seeds.bit_generator.state,
            "teacher": self.teacher.save(),
            "trials": self._untrained.state,
        }
        (folder / "run.pickle").write_bytes(pickle.dumps(state))
        return tuple(f"{STUDENT}/{name}" for name in unchanged)

    def load(self, folder: Path) -> None:
        """Restore the state that `save` wrote for the same spec."""
        state = pickle.loads((folder / "run.pickle").read_bytes())
        self.progress = Progress(**state["progress"])
        self._episode_seeds.bit_generator.state = state["episode_seeds"]
        self.teacher.load(state["teacher"])
        if "trials" in state:  # absent from old checkpoints
            self._untrained.state = state["trials"]
        self.student.load(folder / STUDENT)
        self._next_event = self._event_after(self.progress.step)

    def close(self) -> None:
        """Close all environments."""
        self.environment.close()
        self._evaluation.close()
        self._untrained.close()

    def _play(self) -> Episode | None:
        task, student, environment = self.progress.next_task, self.student, self.environment
        assert task is not None, "a run that has begun has a next task"
        trains = self.progress.next_trains
        act = student.act if trains else partial(self._untrained.act, student)
        seed = int(self._episode_seeds.integers(2**31))
        initial, _ = environment.reset(seed=seed, options={"task": self._world_task(task)})
        copies = self._copies
        if copies:
            initial = np.array(initial)
        recorder = Recorder(initial, student.gamma) if self.progress.record_next else None
        observation = initial
        so_far, discounted_return, discount = EpisodeSoFar(), 0.0, 1.0
        while self.progress.step < self.spec.schedule.steps:
            action = act(observation)
            next_observation, reward, terminated, truncated, _ = environment.step(action)
            if copies:
                next_observation = np.array(next_observation)
            reward = float(reward)
            step = Transition(observation, action, reward, next_observation, terminated, truncated)
            if recorder is not None:
                recorder.add(action, reward, next_observation, terminated)
            if trains:
                student.observe(step)
            observation = next_observation
            so_far.add(reward)
            discounted_return += discount * reward
            discount *= student.gamma
            self.progress.step += 1
            episode = None
            if terminated or truncated:
                episodic_return = so_far.episodic_return
                mastered = episodic_return > self.spec.mastery_threshold
                end = initial, discounted_return, self.progress.step, trains
                episode = Episode(task, episodic_return, mastered, so_far.steps, *end)
                self._end(episode, recorder)
            while self._next_event <= self.progress.step:
                self._events(self._next_event)
            if episode is not None:
                return episode
        return None

    def _diverged(self) -> bool:
        """Return True if the student's action, or its value of a state, is not finite."""
        space = self.environment.observation_space
        assert space.shape is not None, "students learn from boxes"
        observations = np.zeros((1, *space.shape), np.float32)
        for answer in (self.student.act_greedily, self.student.state_values):
            with suppress(Exception):  # a diverged student may raise any error
                if not np.isfinite(answer(observations)).all():
                    return True
        return False

    def _end(self, episode: Episode, recorder: Recorder | None) -> None:
        if episode.trains:
            self.progress.window.append((episode.episodic_return, episode.length, episode.success))
        row = {
            "step": episode.step,
            "episode": self.progress.episodes,
            "task": episode.task,
            "world_task": None if self._landscape is None else self._world_task(episode.task),
            "episodic_return": episode.episodic_return,
            "length": episode.length,
            "success": episode.success,
            "trains": episode.trains,
        }
        self.writer.add(Table.EPISODES, [row])
        self.progress.episodes += 1
        self._receive(self.teacher.exchange(episode), recorder)

    def _world_task(self, task: Task) -> Task:
        """Return the environment's task for a teacher's task; they differ only if the space is shuffled."""
        return task if self._landscape is None else self._landscape.to_world(task)

    def _receive(self, reply: Reply, recorder: Recorder | None = None) -> None:
        self._log(reply.updates)
        while reply.query is not None:
            answer = self._answer(reply.query, recorder)
            if answer is None:
                return
            reply = self.teacher.answer(answer)
            self._log(reply.updates)
        assert reply.task is not None, "a reply without a query holds a task"
        self.progress.next_task = reply.task
        self.progress.record_next = reply.wants_trajectory
        self.progress.next_trains = reply.trains

    def _answer(self, query: Query, recorder: Recorder | None) -> Answer | None:
        """Return the answer to `query`, or None if an evaluation has exhausted the budget."""
        if query.kind is QueryKind.STATE_VALUES:
            assert query.observations is not None, "a query for values holds observations"
            return self.student.state_values(query.observations)
        if query.kind is QueryKind.EVALUATION:
            assert query.tasks is not None, "a query for an evaluation holds tasks"
            left = self.spec.schedule.steps - self.progress.step
            tasks = np.stack([self._world_task(task) for task in query.tasks])
            outcomes = self._untrained.evaluate(self.student, tasks, query.greedy, left)
            if outcomes is None:
                self.progress.step += left
                return None
            for task, episodic_return in zip(query.tasks, outcomes.episodic_returns, strict=True):
                where = f"an episode that the teacher asked for at step {self.progress.step}"
                check_return(episodic_return, task, where)
            self.progress.step += int(outcomes.lengths.sum())
            return outcomes
        if recorder is None:
            raise ValueError(
                f"teacher {self.spec.teacher!r} asked for a trajectory that was not recorded: "
                f"declare wants_trajectory = True in its class"
            )
        trajectory = recorder.trajectory()
        bonuses = self.student.entropy_bonuses(trajectory.observations[:-1])
        return replace(trajectory, entropy_bonuses=bonuses) if bonuses.any() else trajectory

    def _events(self, step: int) -> None:
        """Perform the evaluation, probe, training statistics and reset due at `step`, in this order."""
        schedule = self.spec.schedule
        if step % schedule.evaluation_interval == 0 or step == schedule.steps:
            rows = [{"step": step, **row} for row in self._evaluation(self.student.act_greedily)]
            self.writer.add(Table.EVALUATIONS, rows)
            self.progress.evaluations += 1
        if step % schedule.probe_interval == 0:
            probe = self.teacher.probe(schedule.probe_size)
            rows = [{"step": step, "sample": index, "task": task} for index, task in enumerate(probe)]
            self.writer.add(Table.CURRICULUM, rows)
        if step and step % schedule.training_window == 0:
            self._record_window(step)
        if step in self.spec.resets:
            self.student.reset()
        self._next_event = self._event_after(step)

    def _event_after(self, step: int) -> int:
        """Return the step of the next event (evaluation, probe, statistics, reset or end) after `step`."""
        schedule = self.spec.schedule
        intervals = (schedule.evaluation_interval, schedule.probe_interval, schedule.training_window)
        regular = (step - step % interval + interval for interval in intervals)
        end = max(schedule.steps, step + 1)
        return min(end, *regular, *(reset for reset in self.spec.resets if reset > step))

    def _record_window(self, step: int) -> None:
        if not self.progress.window:
            return
        episodic_returns, lengths, successes = np.array(self.progress.window, dtype=float).T
        row = {
            "step": step,
            "episodes": len(episodic_returns),
            "mean_return": float(episodic_returns.mean()),
            "std_return": float(episodic_returns.std()),
            "mean_length": float(lengths.mean()),
            "success_share": float(successes.mean()),
        }
        self.writer.add(Table.TRAINING, [row])
        self.progress.window = []

    def _log(self, updates: tuple[TeacherUpdate, ...]) -> None:
        position = self.progress.step, self.progress.episodes
        self.writer.add(Table.TEACHER_LOG, [teacher_log_row(*position, update) for update in updates])


def teacher_log_row(step: int, episode: int, update: TeacherUpdate) -> dict[str, object]:
    """Return a teacher's update at a step and episode as a row of the teacher log."""
    return {
        "step": step,
        "episode": episode,
        "gaussians": [
            {"weight": part.weight, "mean": part.mean.tolist(), "covariance": part.covariance.tolist()}
            for part in update.gaussians
        ],
        "boxes": [
            {"low": box.low.tolist(), "high": box.high.tolist(), "score": box.score} for box in update.boxes
        ],
        "scalars": update.scalars,
    }
