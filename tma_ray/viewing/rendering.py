"""Rendering of an episode as a video or a picture."""

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tma_ray.envs import ENVIRONMENTS, Environment, box_spaces, make_environment
from tma_ray.runs.checkpoints import StepPolicy, find_policy
from tma_ray.runs.inputs import arguments
from tma_ray.support.component_names import nearest
from tma_ray.support.gifs import gif_bytes
from tma_ray.support.quantities import COORDINATE
from tma_ray.support.validation import check_fields, check_whole
from tma_ray.tasks import EpisodeSoFar, Task, TaskSpace, check_task

Frame = NDArray[np.uint8]  # RGB picture (height, width, 3)


def check_picture(path: Path) -> None:
    """Check that `write_frames` can write the file `path`.

    Raises:
        ValueError: if the suffix is not .mp4, .gif or .png, the folder is missing or not writable, or PyAV is
            missing for an .mp4.
    """
    folder = path.absolute().parent
    if path.suffix not in _WRITERS:
        raise ValueError(f"{path}: expected a file that ends in {', '.join(_WRITERS)}")
    if not folder.is_dir():
        raise ValueError(f"{path}: the folder {folder} does not exist")
    if not os.access(folder, os.W_OK | os.X_OK) or path.is_dir():
        raise ValueError(f"{path}: cannot be written; choose another folder or name")
    if path.suffix == ".mp4":
        try:
            import av  # noqa: F401
        except ImportError as error:
            raise ValueError(
                f"{path}: an .mp4 needs PyAV: pip install 'tma_ray[render]', or choose .gif or .png"
            ) from error


def write_frames(path: Path, frames: Iterable[Frame], frames_per_second: Fraction) -> None:
    """Write `frames`, at least one and all of one size, to `path` atomically; its suffix sets the format.

    A .png contains the last frame only. Errors are those of `check_picture`.
    """
    check_picture(path)
    unfinished = path.with_name(f".{uuid4().hex}{path.suffix}")
    try:
        _WRITERS[path.suffix](unfinished, frames, frames_per_second)
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def _write_mp4(path: Path, frames: Iterable[Frame], frames_per_second: Fraction) -> None:
    import av

    with av.open(str(path), "w") as container:
        stream = None
        for frame in frames:
            even = frame[: len(frame) // 2 * 2, : frame.shape[1] // 2 * 2]  # H.264 needs even sizes
            if stream is None:
                stream = container.add_stream("libx264", rate=frames_per_second)
                stream.height, stream.width = even.shape[:2]
                stream.pix_fmt = "yuv420p"
                stream.options = {"crf": "20"}  # constant rate factor, from 0 (lossless) to 51
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(even), "rgb24")))
        assert stream is not None
        container.mux(stream.encode(None))


def _write_gif(path: Path, frames: Iterable[Frame], frames_per_second: Fraction) -> None:
    path.write_bytes(gif_bytes(list(frames), 1 / frames_per_second))


def _write_png(path: Path, frames: Iterable[Frame], _frames_per_second: Fraction) -> None:
    *_, last = frames
    Image.fromarray(last).save(path, optimize=True)


_WRITERS: dict[str, Callable[[Path, Iterable[Frame], Fraction], None]] = {
    ".mp4": _write_mp4,
    ".gif": _write_gif,
    ".png": _write_png,
}


RANDOM, ZERO = "random", "zero"  # names of the untrained policies
DEFAULT_ENVIRONMENT, DEFAULT_EMBODIMENT = "stump_tracks", "classic_bipedal"


@dataclass(frozen=True)
class EpisodeSettings:
    """Settings of a rendered episode.

    Attributes:
        policy: "random" (uniform actions), "zero", the folder of a saved policy, or an unambiguous prefix of
            a run id in `results`.
        results: folder or URI of a results root.
        environment: registered name or ``module:Name``; None for that of the run, else Stump Tracks.
        embodiment: name of the body, empty for none; None for that of the run, else the classic bipedal.
        seed: seed of worlds, random tasks and random actions.
        steps: largest number of steps.
        every: steps from one frame to the next.
        task: text for `parse_task`.
    """

    policy: str = RANDOM
    results: str | Path = "results"
    environment: str | None = None
    embodiment: str | None = None
    seed: int = 0
    steps: int = 1000
    every: int = 2
    task: str | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        for name, least in (("seed", 0), ("steps", 0), ("every", 1)):
            check_whole(name, getattr(self, name), least)


@dataclass
class RenderedEnvironment:
    """Environment that draws frames, with the policy that acts in it."""

    environment: Environment  # environment with the render mode "rgb_array"
    trained: StepPolicy | None  # trained policy, if any
    space: TaskSpace  # tasks that a teacher may choose
    domain: TaskSpace  # tasks that the environment can build

    def frame(self) -> Frame:
        """Return the current frame (height, width, 3)."""
        return np.asarray(self.environment.render(), dtype=np.uint8)


def open_rendered(settings: EpisodeSettings) -> RenderedEnvironment:
    """Return the environment and the policy described by `settings`.

    Raises:
        ValueError: if the policy is unknown or does not fit, or the environment cannot be drawn.
    """
    policy = settings.policy
    saved = None if policy in (RANDOM, ZERO) else find_policy(policy, settings.results)
    spec = saved.spec if saved else None
    name = settings.environment or (spec.environment if spec else DEFAULT_ENVIRONMENT)
    run_options = arguments(spec, "environment") if spec else {}
    options = run_options if spec and spec.environment == name else {}
    body = settings.embodiment
    if body is None and "embodiment" not in options:
        body = run_options.get("embodiment", "") if spec else DEFAULT_EMBODIMENT
    if body:
        options["embodiment"] = body
    elif body is not None:
        options.pop("embodiment", None)
    if "rgb_array" not in ENVIRONMENTS.get(name).metadata.get("render_modes", ()):
        raise ValueError(f"environment {name!r} cannot be drawn: it has no render mode 'rgb_array'")
    made = make_environment(name, render_mode="rgb_array", **options)
    try:
        observations, actions = box_spaces(made)
        domain: TaskSpace = made.get_wrapper_attr("valid_domain")
        space = spec.task_space if spec else None
        if space is None or space.names != domain.names:  # a policy from another environment
            space = made.get_wrapper_attr("task_space")
        trained = None if saved is None else saved.load(observations, actions)
        return RenderedEnvironment(made, trained, space, domain)
    except ValueError:
        made.close()
        raise


@dataclass
class RenderedEpisode(EpisodeSoFar):
    """State of a rendered episode."""

    task: Task = field(kw_only=True)  # played task (d,)
    ended: bool = False
    success: bool = False


def render(settings: EpisodeSettings, output: Path) -> RenderedEpisode:
    """Render an episode to `output` (.mp4, .gif, or .png of the last frame), and return its final state.

    Raises:
        ValueError: if the file cannot be written, the policy is unknown or does not fit, the environment
            cannot be drawn, or the task is outside its valid domain.
    """
    check_picture(output)
    rendered = open_rendered(settings)
    try:
        tasks, rng = (np.random.default_rng([settings.seed, stream]) for stream in range(2))
        episode = RenderedEpisode(task=parse_task(settings.task, rendered.space, rendered.domain, tasks))
        every = 0 if output.suffix == ".png" else settings.every
        actions: Any = rendered.environment.action_space
        untrained: dict[str, StepPolicy] = {
            RANDOM: lambda _: rng.uniform(actions.low, actions.high).astype(np.float32),
            ZERO: lambda _: np.zeros(actions.shape, np.float32),
        }
        policy = rendered.trained or untrained[settings.policy]
        rate = Fraction(rendered.environment.metadata.get("render_fps", 50))
        write_frames(output, _play(rendered, policy, settings, episode, every), rate / settings.every)
    finally:
        rendered.environment.close()
    return episode


def parse_task(text: str | None, space: TaskSpace, domain: TaskSpace, rng: np.random.Generator) -> Task:
    """Return the task (d,) described by `text`, which may request a random one.

    Args:
        text: "3,0.5", or "stump_height=3" with the other dimensions in the middle of `space`; None for the
            middle, "random" for a task drawn from `space`.
        space: tasks that a teacher may choose.
        domain: tasks that the environment can build.
        rng: generator of a random task.

    Raises:
        ValueError: if values are not numbers, their number is wrong, a dimension is unknown, or the task is
            outside `domain`.
    """
    if text == "random":
        return space.sample(rng)
    values = dict(zip(space.names, space.centre, strict=True))
    parts = [part.strip() for part in text.split(",")] if text else []
    if any("=" in part for part in parts):
        pairs = [part.partition("=")[::2] for part in parts]
    elif parts and len(parts) != space.size:
        raise ValueError(f"task {text!r}: expected {space.size} numbers ({', '.join(space.names)})")
    else:
        pairs = list(zip(space.names, parts, strict=False))
    for name, value in pairs:
        if name.strip() not in values:
            hint = nearest(name.strip(), space.names)
            raise ValueError(f"task {text!r}: no dimension {name!r}: {hint}known: {', '.join(space.names)}")
        try:
            values[name.strip()] = COORDINATE(value)
        except ValueError:
            raise ValueError(f"task {text!r}: {name} = {value!r}: expected a number") from None
    return check_task(list(values.values()), domain)


def _play(
    rendered: RenderedEnvironment,
    policy: StepPolicy,
    settings: EpisodeSettings,
    episode: RenderedEpisode,
    every: int,
) -> Iterator[Frame]:
    """Yield a frame every `every` steps and the last frame, or only the last if `every` is 0."""
    environment = rendered.environment
    observation, _ = environment.reset(seed=settings.seed, options={"task": episode.task})
    while episode.steps < settings.steps and not episode.ended:
        if every and episode.steps % every == 0:
            yield rendered.frame()
        observation, reward, terminated, truncated, info = environment.step(policy(observation))
        episode.add(float(reward))
        episode.ended = bool(terminated or truncated)
        episode.success = bool(info.get("success", False))
    yield rendered.frame()
