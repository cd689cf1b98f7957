"""Commands that export policies and show them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Any

from cyclopts import Parameter

from tma_ray.cli.options import Count, Licence, NewFile, Output, Policy, RunResults, Seed
from tma_ray.command_line import command, value, values
from tma_ray.commands.values import named


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """Options that choose a world, a policy and the frames of an episode.

    Attributes:
        environment: environment (default: the run's, else stump_tracks)
        embodiment: body (default: the run's, else classic_bipedal)
        policy: a run, the folder of a saved policy, random (uniform actions) or zero (none)
        seed: seed of worlds, random tasks and random actions
        steps: steps after which an episode is left
        every: steps from one frame to the next
    """

    environment: Annotated[str | None, value(named("the name of an environment"), "NAME")] = None
    embodiment: Annotated[str | None, value(named("the name of a body"), "NAME")] = None
    policy: Policy = "random"
    results: RunResults = "results"
    seed: Seed = 0
    steps: Count = 1000
    every: Count = 2

    def given(self) -> dict[str, Any]:
        """Return the options as settings of `tma_ray.viewing`."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


@command()
def export(
    policy: Policy,
    /,
    *,
    output: Output,
    results: RunResults = "results",
    licence: Licence | None = None,
    no_onnx: bool = False,
) -> int:
    """Export a policy as safetensors and ONNX, with a model card.

    Args:
        policy: ID of a run or its beginning, or the folder of a saved policy
        output: new or empty folder to write to
        licence: licence of the policy, as CC-BY-4.0 (default: none)
        no_onnx: leave the ONNX file out
    """
    from tma_ray.export import export as write

    done = write(policy, output, results, licence or "", not no_onnx)
    if done.difference is not None:
        print(f"{done.folder}: actions of the ONNX file differ by at most {done.difference:.2g}")
    else:
        print(f"{done.folder}: without an ONNX file")
    return 0


@command()
def render(
    *,
    output: NewFile,
    task: Annotated[str | None, value(named("a task"), "TASK")] = None,
    scene: SceneOptions = SceneOptions(),
) -> int:
    """Render an episode as a video or a picture.

    It is of a saved policy, of random actions or of none.

    Args:
        output: video (.mp4, .gif) or picture (.png)
        task: values as 0.5,3, pairs as stump_height=0.5,obstacle_spacing=3, or random (default: the middle of
            the task space)
    """
    from tma_ray.viewing.rendering import EpisodeSettings
    from tma_ray.viewing.rendering import render as draw

    episode = draw(EpisodeSettings(**scene.given(), task=task), output)
    success = "mastered" if episode.success else "not mastered"
    end = f"ended after {episode.steps}" if episode.ended else f"left after {episode.steps}"
    print(f"{output}: {end} steps, return {episode.episodic_return:.1f}, {success}")
    return 0


@command()
def play(
    *,
    task: Annotated[tuple[str, ...], values(named("a task"), "TASK")] = (),
    size: Annotated[str | None, value(named("width and height"), "SIZE")] = None,
    output: NewFile | None = None,
    scene: SceneOptions = SceneOptions(),
) -> int:
    """Show a policy live in a window, on tasks chosen with sliders.

    With --output, film it on given tasks instead; --steps and --every are of the video.

    Args:
        task: values as 0.5,3, pairs as stump_height=0.5,obstacle_spacing=3, or random; repeatable, for
            several in turn (default: the middle of the task space)
        size: pixels of the window, as 640x480 (default: as the world needs)
        output: video (.mp4, .gif) or picture (.png) instead of a window (default: none)
    """
    from tma_ray.viewing.play import playing

    settings = playing.PlaySettings(
        **scene.given(), tasks=task or (None,), size=playing.parse_size(size) if size else None
    )
    if output is None:
        playing.play(settings)
        return 0
    for episode in playing.record(settings, output):
        end = f"ended after {episode.steps}" if episode.ended else f"left after {episode.steps}"
        mastered = "mastered" if episode.mastered else "not mastered"
        numbers = ", ".join(f"{value:g}" for value in episode.task)
        print(f"task {numbers}: {end} steps, return {episode.episodic_return:.1f}, {mastered}")
    print(output)
    return 0
